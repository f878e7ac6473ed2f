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
import math
from statistics import NormalDist

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.small_algebra import (
    determinant, inverse, is_positive_definite)
from startracker_ros.core.options import option, Options

MISSED_DETECTION = 1e-4
"""Share of false stars that no test rejects: what each rejected star says of the others."""


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
    count, unbounded = len(sensor), np.full(3, np.inf)
    false = options.false_star_probability + MISSED_DETECTION * rejected / max(count, 1)
    one, two, three = (math.comb(count, k) * false ** k for k in (1, 2, 3))
    # Each axis has its own probability.
    left = (options.misleading_probability - three) / 3
    if left <= 0 or count < 3:
        return unbounded
    separation, more = _without_each(sensor, sigma_rad ** -2.0, residual_rad)
    if not len(separation):
        return unbounded
    variance = np.diagonal(covariance)
    pair, pair_more = (np.sort(values, axis=0)[-2:].sum(axis=0) for values in (separation, more))
    levels = [_sigmas(left) * np.sqrt(variance)[None],
              separation + _sigmas(left / one) * np.sqrt(variance + more)]
    if two > left:
        levels.append((pair + _sigmas(left / two) * np.sqrt(variance + pair_more))[None])
    return np.vstack(levels).max(axis=0)


@compiled
def _without_each(sensor: np.ndarray, weight: np.ndarray, residual_rad: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return |x - x_i| (N, 3) of each star, and the diagonal (N, 3) of (F - F_i)^-1 - F^-1.

    Both are empty where the attitude is not observable without a star.
    """
    count, F = len(sensor), np.zeros((3, 3))
    for i in range(count):
        F += _information(sensor[i], weight[i])
    smallest, all_stars = 1e-9 * determinant(F), inverse(F)
    separation, more = np.empty((count, 3)), np.empty((count, 3))
    for i in range(count):
        p, without = sensor[i], F - _information(sensor[i], weight[i])
        if determinant(without) <= smallest:
            return np.empty((0, 3)), np.empty((0, 3))
        A = inverse(without)
        for axis in range(3):
            a = A[axis]
            along = a[0] * p[0] + a[1] * p[1] + a[2] * p[2]
            # |a x p|^2 = a^2 - (a p)^2.
            across = a[0] * a[0] + a[1] * a[1] + a[2] * a[2] - along * along
            separation[i, axis] = residual_rad[i] * weight[i] * np.sqrt(max(across, 0.0))
            more[i, axis] = max(A[axis, axis] - all_stars[axis, axis], 0.0)
    return separation, more


@compiled
def _information(p: np.ndarray, weight: float) -> np.ndarray:
    """Return w (I - p p^T)."""
    return weight * (np.eye(3) - np.outer(p, p))


def _sigmas(probability: float) -> float:
    """Return how many sigma a normal value exceeds, up or down, with a probability."""
    return -NormalDist().inv_cdf(min(probability, 1.0) / 2) if probability < 1 else 0.0


def is_covariance(covariance: np.ndarray) -> bool:
    """Return whether a matrix (3, 3) is finite, symmetric and positive definite."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = covariance.tolist()
    symmetric = all(abs(a - b) <= 1e-6 * abs(a) + 1e-300 for a, b in (
        (xy, yx), (xz, zx), (yz, zy)))
    return bool(symmetric and math.isfinite(covariance.sum())
                and is_positive_definite(np.ascontiguousarray(covariance)))
