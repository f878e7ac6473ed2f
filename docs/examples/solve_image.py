# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude of a star image, without ROS."""

import sys

import startracker_ros as st

solution = st.solve(sys.argv[1], fov_deg=float(sys.argv[2]), epoch=float(sys.argv[3]))
if not solution.solved:
    sys.exit(solution.reason)
print(f'right ascension {solution.ra_deg:.3f}, declination {solution.dec_deg:.3f}, '
      f'roll {solution.roll_deg:.2f} deg')
print(f'{solution.matched} stars, field of view {solution.fov_deg:.2f} deg')
