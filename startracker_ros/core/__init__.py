# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The star tracker: no ROS, no files of users, no command line."""
