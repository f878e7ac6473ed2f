# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS messages from NumPy arrays and stage results, and back; one module for each kind."""
