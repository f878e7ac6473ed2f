# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The position of a target from two lines of sight, or the reason why there is none."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.locate import triangulation
from startracker_ros.core.locate.line_of_sight import LineOfSight
from startracker_ros.core.options import option, Options


class LocationError(ValueError):
    """Two lines of sight that give no position; the text is the reason."""


@dataclass(frozen=True)
class LocationOptions(Options):
    """How two lines of sight are triangulated, and when they are rejected."""

    solution: str = option(
        'weighted', 'weighted: by the covariance of each line of sight (maximum likelihood); '
        'least_squares: equal weights', choices=('weighted', 'least_squares'))
    min_angle_deg: float = option(
        0.5, 'smallest angle between the two lines of sight; below it the ranges are hardly '
        'determined', unit='deg', low=1e-3, high=90.0)
    min_baseline_m: float = option(
        100.0, 'smallest distance between the observers', unit='m', low=1e-3, high=1e8)
    max_miss_sigmas: float = option(
        5.0, 'largest distance between the two lines of sight, in units of its sigma; beyond it '
        'they point to different targets', low=1.0, high=1000.0)


@dataclass(frozen=True)
class Location:
    """
    The position of a target and its statistics.

    position_m (3,) on ICRF axes and its covariance_m2 (3, 3); range_m (2,) from each observer;
    angle_rad between the lines of sight; miss_m is their smallest distance and miss_sigma_m its
    expected sigma.
    """

    position_m: np.ndarray
    covariance_m2: np.ndarray
    range_m: np.ndarray
    angle_rad: float
    miss_m: float
    miss_sigma_m: float


_REASONS = {
    triangulation.NOT_FINITE: 'NaN or infinity in a line of sight',
    triangulation.NOT_UNIT: 'a line of sight without a direction of unit length',
    triangulation.BEHIND_FIRST: 'the lines of sight meet behind the first observer',
    triangulation.BEHIND_SECOND: 'the lines of sight meet behind the second observer',
    triangulation.COVARIANCE: 'a covariance that is not positive'}


def locate(first: LineOfSight, second: LineOfSight,
           options: LocationOptions = LocationOptions()) -> Location:
    """Return the position nearest to two lines of sight; LocationError with the reason."""
    lines = (first, second)
    position = np.array([line.position_m for line in lines], float)
    direction = np.array([line.direction for line in lines], float)
    covariance = np.array([line.covariance for line in lines], float)
    found = triangulation.Triangulated(*(values[0] for values in triangulation.triangulate(
        position[None], direction[None], covariance[None], options.solution == 'weighted',
        options.min_baseline_m, np.sin(np.radians(options.min_angle_deg)))))
    status = int(found.status)
    if status == triangulation.SHORT_BASELINE:
        raise LocationError(f'observers {np.linalg.norm(position[1] - position[0]):.3g} m apart, '
                            f'at least {options.min_baseline_m:g} m are needed')
    angle_rad = float(np.arctan2(found.sine, direction[0] @ direction[1]))
    if status == triangulation.PARALLEL:
        raise LocationError(f'lines of sight parallel within {options.min_angle_deg:g} deg: '
                            f'{np.degrees(min(angle_rad, np.pi - angle_rad)):.3g} deg')
    if status != triangulation.LOCATED:
        raise LocationError(_REASONS[status])
    miss_m, miss_sigma_m = float(found.miss), float(found.miss_sigma)
    if miss_m > options.max_miss_sigmas * miss_sigma_m:
        raise LocationError(
            f'lines of sight pass each other at {miss_m:.4g} m, {miss_sigma_m:.3g} m 1 sigma: '
            'they do not point to one target')
    return Location(found.target, found.covariance, found.rho, angle_rad, miss_m, miss_sigma_m)
