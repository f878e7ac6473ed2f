# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a data sheet states of a camera with this star tracker, and what a design will reach."""
