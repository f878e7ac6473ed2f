# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Protection level: a bound of the error per axis that hides no more than a stated probability.

native/src/integrity/protection.h tells its equations.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class ProtectionOptions(Options):
    """The probabilities of the protection level."""

    misleading_probability: float = option(
        1e-7, 'probability, of each frame, that the error of an axis exceeds protection_level',
        low=1e-12, high=0.1, live=True)
    false_star_probability: float = option(
        1e-5, 'probability of a star, in each frame, to be false (a blend, a planet, dust) '
        'and that no test has rejected it', low=1e-9, high=0.01, live=True)


def protection_level(covariance: np.ndarray, sensor: np.ndarray, sigma_rad: np.ndarray,
                     residual_rad: np.ndarray, options: ProtectionOptions = ProtectionOptions(),
                     rejected: int = 0) -> np.ndarray:
    """
    Return the bound (3,) rad of the errors about sensor axes.

    covariance (3, 3) rad^2 is that of the attitude; sensor (N, 3) are the unit vectors of its
    stars, sigma_rad (N,) their errors per axis, residual_rad (N,) how far they are from the
    catalogue; rejected counts stars that were found to be false. Infinite where N stars are too
    few to do without one, or so many may be false that the probability cannot be kept.
    """
    level = np.empty(3)
    native.call('st_protection_level', np.ascontiguousarray(covariance, float),
                np.column_stack([sensor, sigma_rad, residual_rad]), len(sensor),
                options.misleading_probability, options.false_star_probability, rejected, level)
    return level
