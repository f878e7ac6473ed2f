# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Your images with known answers: how many are solved, and how far off they are."""

import csv
from pathlib import Path
import sys

import numpy as np
import startracker_ros as st


def direction(ra_deg, dec_deg):
    ra, dec = np.radians([ra_deg, dec_deg])
    return np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])


folder = Path(sys.argv[1])
with open(folder / 'solutions.csv') as table:
    known = [row for row in csv.DictReader(table) if row['ra_deg']]
for row in known:
    solution = st.solve(folder / row['file'], fov_deg=float(row['hfov_deg']))
    if not solution.solved:
        print(f'{row["file"]}: {solution.reason}')
        continue
    cosine = (direction(solution.ra_deg, solution.dec_deg)
              @ direction(float(row['ra_deg']), float(row['dec_deg'])))
    print(f'{row["file"]}: {solution.matched} stars, '
          f'{np.degrees(np.arccos(min(cosine, 1.0))):.2f} deg from the answer')
