# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags: MCAP files and folders as rosbag2 (Jazzy) writes them."""
