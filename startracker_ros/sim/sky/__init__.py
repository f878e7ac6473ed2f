# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated sky: motion, orbit, stars in view, detector and gyro."""
