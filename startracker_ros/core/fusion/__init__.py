# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude of a body out of several star trackers and a gyro, and the mounts of the heads."""
