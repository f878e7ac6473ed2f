# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The position of a target from the lines of sight of two observers."""
