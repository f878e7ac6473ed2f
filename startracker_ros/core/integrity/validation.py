# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The limits of an attitude that can be trusted, and the result."""

from dataclasses import dataclass, field

import numpy as np
from startracker_ros.core.attitude.result import AttitudeEstimate, SOLVERS
from startracker_ros.core.options import option, Options

UNUSED_SOLVER = (
    'attitude_estimator.solver = {} has no effect on the attitude of a star tracker: set '
    'star_tracker.solver, with another model than attitude')


@dataclass(frozen=True)
class ValidationOptions(Options):
    """The solver, and the limits that an attitude must keep to be published."""

    solver: str = option(
        'quest', 'solver of stars of single frames and of tracks without tracked_attitude, which '
        'star_tracker solves by its own: quest, davenport and svd find the same best fit of all '
        'stars, triad takes the two that determine the attitude best',
        choices=SOLVERS, live=True)
    min_stars: int = option(
        4, 'fewest stars of a trusted attitude; three or fewer cannot show a wrong one',
        low=2, high=100, live=True)
    max_residual_px: float = option(
        1.0, 'largest rms residual of the stars, measured minus catalogue; '
        'raise it for a lens that is not calibrated', unit='px', low=0.01, high=100.0,
        live=True)


@dataclass(frozen=True)
class TrustedAttitude:
    """
    An attitude, or None and the reason why there is none.

    protection_rad (3,) bounds the errors about sensor axes; infinite where there is no bound, or
    no attitude.
    """

    attitude: AttitudeEstimate | None
    reason: str
    protection_rad: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
