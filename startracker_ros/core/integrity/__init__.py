# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether an attitude is trusted, and how far it may be wrong."""
