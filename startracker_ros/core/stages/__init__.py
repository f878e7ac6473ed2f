# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policy of the star tracker: which stage works on a frame, and which attitude goes out."""
