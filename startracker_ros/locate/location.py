"""Where two lines of sight meet, how sure that is, and why there is no answer."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.locate import solution
from startracker_ros.locate.sight import Sight
from startracker_ros.options import option, Options


class LocationError(ValueError):
    """Two sights that give no place; the text says why."""


@dataclass(frozen=True)
class LocationOptions(Options):
    """How two lines of sight are joined, and when they are refused."""

    solution: str = option(
        'weighted', 'weighted: by the covariance of each line of sight (maximum likelihood); '
        'least_squares: both lines count alike', choices=('weighted', 'least_squares'))
    min_angle_deg: float = option(
        0.5, 'smallest angle between the two lines of sight: below it the ranges are hardly '
        'determined', unit='deg', low=1e-3, high=90.0)
    min_baseline_m: float = option(
        100.0, 'smallest distance between the observers', unit='m', low=1e-3, high=1e8)
    max_miss_sigmas: float = option(
        5.0, 'how far the two lines may pass each other, in units of the sigma of that '
        'distance: further apart they point to different targets', low=1.0, high=1000.0)


@dataclass(frozen=True)
class Location:
    """
    A place and its statistics.

    position_m (3,) on ICRF axes and its covariance_m2 (3, 3); range_m (2,) from each observer;
    angle_rad between the lines of sight; miss_m is their smallest distance, miss_sigma_m
    what it is expected to be.
    """

    position_m: np.ndarray
    covariance_m2: np.ndarray
    range_m: np.ndarray
    angle_rad: float
    miss_m: float
    miss_sigma_m: float


_REASONS = {
    solution.NOT_FINITE: 'NaN or infinity in a line of sight',
    solution.NOT_UNIT: 'a line of sight without a direction of unit length',
    solution.BEHIND_FIRST: 'the lines of sight meet behind the first observer',
    solution.BEHIND_SECOND: 'the lines of sight meet behind the second observer',
    solution.COVARIANCE: 'a covariance that is not positive'}


def locate(first: Sight, second: Sight,
           options: LocationOptions = LocationOptions()) -> Location:
    """Return where two lines of sight meet; LocationError says why they do not."""
    place, spread, measures = np.empty(3), np.empty((3, 3)), np.full(5, np.nan)
    sights = (first, second)
    position = np.array([sight.position_m for sight in sights], float)
    direction = np.array([sight.direction for sight in sights], float)
    covariance = np.array([sight.covariance for sight in sights], float)
    ended = solution.solve(
        position, direction, covariance, options.solution == 'weighted', options.min_baseline_m,
        np.sin(np.radians(options.min_angle_deg)), place, spread, measures)
    if ended == solution.SAME_PLACE:
        raise LocationError(f'observers {np.linalg.norm(position[1] - position[0]):.3g} m apart, '
                            f'at least {options.min_baseline_m:g} m are needed')
    angle_rad = float(np.arctan2(measures[2], direction[0] @ direction[1]))
    if ended == solution.PARALLEL:
        raise LocationError(f'lines of sight parallel within {options.min_angle_deg:g} deg: '
                            f'{np.degrees(min(angle_rad, np.pi - angle_rad)):.3g} deg')
    if ended != solution.LOCATED:
        raise LocationError(_REASONS[ended])
    miss_m, miss_sigma_m = float(measures[3]), float(measures[4])
    if miss_m > options.max_miss_sigmas * miss_sigma_m:
        raise LocationError(
            f'lines of sight pass each other at {miss_m:.4g} m, {miss_sigma_m:.3g} m 1 sigma: '
            'they do not point to one target')
    return Location(place, spread, measures[:2].copy(), angle_rad, miss_m, miss_sigma_m)
