# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands of `startracker` that measure."""
