# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The only package that imports rclpy: nodes, messages, parameters, processes."""
