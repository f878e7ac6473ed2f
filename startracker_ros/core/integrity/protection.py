# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Protection level: a bound of the error per axis that hides no more than a stated probability.

Solution separation as in multiple-hypothesis receiver autonomous integrity monitoring (RAIM;
Pervan, Pullen and Christie, Navigation 45, 1998; Blanch et al., IEEE Trans. AES 51, 2015). The
hypotheses are that no star is false, and for each star that it is: a blend, a planet or dust that
no test has rejected. Without star i, of Fisher information F_i = w_i (I - p_i p_i^T), the attitude
is

    x_i = x - (F - F_i)^-1 w_i (p_i x r_i),  P_i = P + (F - F_i)^-1 - F^-1

with r_i the residual of the star, F = sum F_i and P the published covariance. If the star is false
x_i is right, so the error of x on an axis exceeds |x - x_i| + k sigma_i in the share 2 Q(k) of all
cases. A third of the probability is that of the first hypothesis, one is shared by the stars and
one by pairs of false stars, for which the two largest separations and variances add up:

    protection = max(k_0 sigma, max_i(|x - x_i| + k_1 sigma_i), pairs)

Three false stars at a time are not tested: their probability is taken off first.
"""

from dataclasses import dataclass
from functools import lru_cache
import math
from statistics import NormalDist

import numpy as np
from startracker_ros.core.attitude.refinement import information
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import PROTECTION
from startracker_ros.core.maths.small_algebra import determinant, inverse, is_positive_definite
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class ProtectionOptions(Options):
    """The probabilities of the protection level."""

    misleading_probability: float = option(
        1e-7, 'probability, of each frame, that the error of an axis exceeds protection_level',
        low=1e-12, high=0.1, live=True)
    false_star_probability: float = option(
        1e-5, 'probability of a star, in each frame, that it is none (a blend, a planet, dust) '
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
    sigmas = _multipliers(len(sensor), rejected, options)
    if sigmas is None:
        return np.full(3, np.inf)
    k_0, k_1, k_2 = sigmas
    covariance, sensor, sigma_rad, residual_rad = map(
        np.ascontiguousarray, (covariance, sensor, sigma_rad, residual_rad))
    return _level(covariance, sensor, sigma_rad, residual_rad, k_0, k_1, k_2)


@lru_cache(maxsize=256)
def _multipliers(count: int, rejected: int, options: ProtectionOptions
                 ) -> tuple[float, float, float] | None:
    """Return k of no, one and two false stars of count, NaN if two are too rare; or None."""
    false = options.false_star_probability + PROTECTION.probability * rejected / max(count, 1)
    one, two, three = (math.comb(count, k) * false ** k for k in (1, 2, 3))
    # Each axis has its own probability.
    left = (options.misleading_probability - three) / 3
    if left <= 0 or count < 3:
        return None
    return (_sigmas(left), _sigmas(left / one), _sigmas(left / two) if two > left else math.nan)


@compiled
def _level(covariance: np.ndarray, sensor: np.ndarray, sigma_rad: np.ndarray,
           residual_rad: np.ndarray, k_0: float, k_1: float, k_2: float) -> np.ndarray:
    """
    Return the largest bound (3,) of all hypotheses, infinite if a star cannot be done without.

    |x - x_i| is the separation, the diagonal of (F - F_i)^-1 - F^-1 what is more of the variance.
    """
    count, weight = len(sensor), 1 / sigma_rad ** 2
    F = information(sensor, weight)
    smallest, all_stars = 1e-9 * determinant(F), inverse(F)
    level, pair, pair_more = np.empty(3), np.zeros((3, 2)), np.zeros((3, 2))
    for axis in range(3):
        level[axis] = k_0 * math.sqrt(covariance[axis, axis])
    for i in range(count):
        p, without = sensor[i], F - information(sensor[i:i + 1], weight[i:i + 1])
        # Not known is not bounded.
        if not (determinant(without) > smallest and np.isfinite(residual_rad[i])):
            return np.full(3, np.inf)
        A = inverse(without)
        for axis in range(3):
            a = A[axis]
            along = a[0] * p[0] + a[1] * p[1] + a[2] * p[2]
            # |a x p|^2 = a^2 - (a p)^2.
            across = a[0] * a[0] + a[1] * a[1] + a[2] * a[2] - along * along
            separation = residual_rad[i] * weight[i] * math.sqrt(max(across, 0.0))
            more = max(a[axis] - all_stars[axis, axis], 0.0)
            level[axis] = max(level[axis], separation
                              + k_1 * math.sqrt(covariance[axis, axis] + more))
            _keep_two(pair[axis], separation)
            _keep_two(pair_more[axis], more)
    for axis in range(3):
        # NaN is never the larger one.
        both = pair[axis].sum() + k_2 * math.sqrt(
            covariance[axis, axis] + pair_more[axis].sum())
        level[axis] = both if both > level[axis] else level[axis]
    return level


@compiled
def _keep_two(largest: np.ndarray, value: float) -> None:
    """Keep the larger two (2,) of those before and a value."""
    if value > largest[0]:
        largest[0], largest[1] = value, largest[0]
    elif value > largest[1]:
        largest[1] = value


def _sigmas(probability: float) -> float:
    """Return how many sigma a normal value exceeds, up or down, with a probability."""
    return -NormalDist().inv_cdf(min(probability, 1.0) / 2) if probability < 1 else 0.0


def is_covariance(covariance: np.ndarray) -> bool:
    """Return whether a matrix (3, 3) is finite, symmetric and positive definite."""
    return _is_covariance(np.ascontiguousarray(covariance))


@compiled
def _is_covariance(P: np.ndarray) -> bool:
    for i in range(3):
        for j in range(3):
            if not (np.isfinite(P[i, j])
                    and abs(P[i, j] - P[j, i]) <= 1e-6 * abs(P[i, j]) + 1e-300):
                return False
    return is_positive_definite(P)
