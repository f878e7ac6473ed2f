# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Time, orbits, planets, aberration: astronomy that flight code and simulator share."""
