# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Smoothed attitudes compared with those of the star tracker, on simulated flights."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from startracker_evaluation.bench.reprocess import flight_bag, processed
from startracker_ros.io.table import Result
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.tools.figures.rows import combined

RATIO = 0.7
_NEES_BOUND = 1.5
CASES = {
    'gyro 0.15 deg/sqrt(h)': 0.15,
    'gyro 0.005 deg/sqrt(h)': 0.005}
"""White noise of the gyro, by case; star tracker and smoother know it."""


@dataclass(frozen=True)
class SmoothingRow:
    """Errors across the boresight on each axis, their ratio, and the NEES, 3 when true."""

    case: str
    frames: int
    filter_arcsec: float
    smoothed_arcsec: float
    ratio: float
    filter_nees: float
    smoothed_nees: float
    bound: str
    holds: bool


def run_smoothing_bench(*, trials: int, seed: int, only: Sequence[str] = tuple(CASES)) -> Result:
    """Follow trials frames at 10 Hz in each case."""
    rows = [_row(case, CASES[case], trials, seed) for case in only]
    return Result('bench smoothing', rows, {
        'recording': 'one head, 12 deg, 10 Hz, gyro of 10 Hz, orbit of 600 km with wobble',
        'seed': seed})


def _row(case: str, gyro_noise: float, trials: int, seed: int) -> SmoothingRow:
    hours = trials / 36_000
    options = FlightOptions(days=hours / 24, bag_hours=hours, rate_hz=10.0, heads=1,
                            gyro_noise_deg_sqrt_h=gyro_noise, focal_drift_percent_day=0.0,
                            focal_orbit_percent=0.0)
    with TemporaryDirectory() as name:
        folder = Path(name)
        _, records = processed(
            flight_bag(folder / 'flight', options, seed), folder / 'out', smooth=True,
            settings=[f'star_tracker.gyro_noise_deg_sqrt_h={gyro_noise}'])
    sums = [np.sum([getattr(record, kind) for record in records], axis=0)
            for kind in ('accuracy', 'smoothed')]
    (tracked, tracked_nees), (smoothed, smoothed_nees) = (
        (float(np.sqrt(squares / 2 / count)), float(nees / count))
        for count, squares, nees in sums)
    ratio = smoothed / tracked
    bound, holds = combined((
        (f'ratio <= {RATIO:g}', ratio <= RATIO),
        (f'NEES {3 / _NEES_BOUND:g} .. {3 * _NEES_BOUND:g}',
         3 / _NEES_BOUND <= smoothed_nees <= 3 * _NEES_BOUND)))
    return SmoothingRow(case, int(sums[0][0]), tracked, smoothed, ratio, tracked_nees,
                        smoothed_nees, bound, holds)
