# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars whose catalogue entry does not fit what is seen, over a whole run."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.tools.reprocess.runs import Run

LEAST_FRAMES = 100
_SIGMAS = 6.0
_LARGEST_DIFFERENCE_MAG = 0.3
_LARGEST_SCATTER_MAG = 0.15
_MAD = 1.4826


@dataclass(frozen=True)
class StarRow:
    """One star: mean residual to east and north, scatter over its errors, magnitude, faults."""

    hip: int
    magnitude: float
    frames: int
    east_arcsec: float
    north_arcsec: float
    scatter_over_sigma: float
    difference_mag: float
    scatter_mag: float
    faults: str


def bad_stars(run: Run) -> list[StarRow]:
    """Return the stars with a fault in any tracker, the worst position first."""
    columns = ('hip', 'magnitude', 'count', 'weight', 'east', 'north', 'chi2', 'difference_mag',
               'square_mag2')
    tables = [run.table('stars', tracker, ['stamp_ns', *columns]) for tracker in run.trackers]
    joined = {name: np.concatenate([table[name] for table in tables]) for name in columns}
    hip, first, which = np.unique(joined['hip'], return_index=True, return_inverse=True)
    sums = {name: np.bincount(which, joined[name], len(hip)) for name in columns[2:]}
    many = sums['count'] >= LEAST_FRAMES
    sums = {name: column[many] for name, column in sums.items()}
    hip, magnitude = hip[many], joined['magnitude'][first][many]
    east, north = sums['east'] / sums['weight'], sums['north'] / sums['weight']
    scatter = np.sqrt(sums['chi2'] / (2 * sums['count']))
    difference = sums['difference_mag'] / sums['count']
    scatter_mag = np.sqrt(np.maximum(sums['square_mag2'] / sums['count'] - difference ** 2, 0))
    # What the lens leaves to all stars is no fault of one.
    floor = _MAD * float(np.median(np.abs(np.stack([east, north])))) if len(hip) else 0.0
    sigma = np.hypot(1 / np.sqrt(sums['weight']), floor)
    offset = np.hypot(east, north)
    rows = []
    for k in np.argsort(-offset):
        faults = [text for text, found in (
            ('position', offset[k] > _SIGMAS * sigma[k]),
            ('scatter', scatter[k] > 2.0),
            ('magnitude', abs(difference[k]) > _LARGEST_DIFFERENCE_MAG),
            ('variable', scatter_mag[k] > _LARGEST_SCATTER_MAG)) if found]
        if faults:
            rows.append(StarRow(
                int(hip[k]), float(magnitude[k]), int(sums['count'][k]), float(east[k]),
                float(north[k]), float(scatter[k]), float(difference[k]),
                float(scatter_mag[k]), ', '.join(faults)))
    return rows
