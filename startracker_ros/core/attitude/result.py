# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An attitude with its statistics."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from startracker_ros.core.attitude.error_budget import ErrorBudget
from startracker_ros.core.maths.rotation import east_and_north, matrix_from_quaternion

SOLVERS = ('quest', 'davenport', 'svd', 'triad')
"""The solvers: three of the same best fit, and the two best stars alone."""

FAILURES = {
    606: 'NaN or infinity among the directions or their sigma',
    607: 'sigma of {:g} rad must be positive',
    608: 'a direction of length zero',
    609: 'directions {:.0f} and {:.0f} are identical: one star counted twice',
    610: 'the directions are parallel, or weighted so unevenly that one star decides alone: the '
         'rotation about them is not observable'}
"""Reasons of the native core for no attitude, by st_reason_code."""

WRONG_SIGMAS = 5.0
"""An attitude is wrong when its error exceeds so many of its own sigma on any axis."""


def failure(code: int, figures: Sequence[float]) -> str:
    """Return why no attitude follows, of an st_reason_code of FAILURES with its figures."""
    return FAILURES[code].format(*figures)


@dataclass(frozen=True)
class AttitudeEstimate:
    """
    An attitude and its statistics.

    quaternion (4,) is q_icrf_from_sensor with w >= 0; covariance_sensor (3, 3) rad^2 is that
    of rotation.attitude_error, a rotation vector about sensor axes; residual_rad (N,) is the
    angle between each star and its catalogue direction; chi2 sums the squares of residual over
    sigma: of the best fit with 2 N - 3 degrees of freedom, else with mean_chi2() as its mean.
    Without stars it is an attitude of which nothing else is known. budget is what the covariance
    consists of, None where that is not known.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray
    stars: int = 0
    residual_rad: np.ndarray = field(default_factory=lambda: np.empty(0))
    chi2: float = np.nan
    budget: ErrorBudget | None = None


def covariance_icrf(q_icrf_from_sensor: np.ndarray, covariance_sensor: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of a rotation vector about sensor axes on ICRF axes."""
    matrix = matrix_from_quaternion(q_icrf_from_sensor)
    return matrix @ covariance_sensor @ matrix.T


def pointing_sigma(q_icrf_from_sensor: np.ndarray, covariance_icrf: np.ndarray) -> np.ndarray:
    """
    Return 1 sigma (3,) in rad of the boresight eastward and northward, and of the roll about it.

    Eastward is right ascension times cos(declination); covariance_icrf (3, 3) is that of a
    rotation vector about ICRF axes.
    """
    boresight = matrix_from_quaternion(q_icrf_from_sensor)[:, 2]
    east, north = east_and_north(boresight)
    # A rotation about the north moves the boresight to the east.
    axes = np.stack([north, east, boresight])
    return np.sqrt(np.diag(axes @ covariance_icrf @ axes.T))
