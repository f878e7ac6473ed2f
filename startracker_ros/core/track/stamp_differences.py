# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The arithmetic of stamp_jitter.py for one frame: compiled."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_quaternion import rotation_between
from startracker_ros.core.maths.small_algebra import inverse, is_positive_definite

FRAMES = 20  # whose times are compared
LIMIT_SIGMAS = 2.5  # a longer time, as that of a jump of the rate, counts as this
LEAST_PRODUCTS = 3
# Times the variance of the measured time by the centroids, of many products and of few.
SIGNIFICANT, FEW = 4.0, 20.0


class Differences(NamedTuple):
    """
    What is remembered of the frames before; the arrays are changed in place.

    left (3,) is the correction minus the measured turn of the last frame, with the sign reversed;
    step (3,) the measured turn between the last two; times_s and variances_s2 (FRAMES,) are t_k
    and r of the newest frames, NaN in front of the first one.
    """

    left: np.ndarray
    step: np.ndarray
    times_s: np.ndarray
    variances_s2: np.ndarray

    @classmethod
    def empty(cls) -> 'Differences':
        """Return those before the first frame."""
        return cls(np.full(3, np.nan), np.full(3, np.nan), np.full(FRAMES, np.nan),
                   np.full(FRAMES, np.nan))


@compiled
def measured_turn(predicted: AttitudeState, corrected: AttitudeState
                  ) -> tuple[bool, np.ndarray, np.ndarray]:
    """
    Return whether the stars of a frame add an attitude, their turn (3,) and covariance (3, 3).

    An update by attitude alone adds its information: Y = P+^-1 - P-^-1 of the attitude, and
    x+ - x- = P+ y. The measured turn is Y^-1 y, its covariance Y^-1.
    """
    information = inverse(corrected.covariance)
    Y = information - inverse(predicted.covariance)
    R = inverse(Y)
    change = rotation_between(predicted.quaternion, corrected.quaternion)
    turn = np.zeros(3)
    for i in range(3):
        y = 0.0
        for j in range(3):
            y += information[i, j] * change[j]
        for k in range(3):
            turn[k] += R[k, i] * y
    return is_positive_definite(Y), turn, R


@compiled
def add_frame(memory: Differences, before: AttitudeState, predicted: AttitudeState,
              corrected: AttitudeState, measured: AttitudeState, rate: np.ndarray,
              interval_ratio: float) -> tuple[bool, float, float]:
    """
    Add t_k of a frame to the memory; return the variance of the stamps and r, both s^2.

    With the attitude a_k that measured has beside the prediction, its covariance R and the rate w
    of stamp_jitter.py: r = 1 / (w^T R^-1 w), t_k = r w^T R^-1 e_k. interval_ratio is
    dt_k / dt_k-1. The first is False where there is no such attitude, or w is zero.
    """
    adds, turn, R = measured_turn(predicted, measured)
    if not adds or not rate.any():
        return False, np.nan, np.nan
    between = rotation_between(before.quaternion, predicted.quaternion)
    correction = rotation_between(predicted.quaternion, corrected.quaternion)
    information = inverse(R)
    along, square = 0.0, 0.0
    for i in range(3):
        weight = 0.0
        for j in range(3):
            weight += information[i, j] * rate[j]
        step = between[i] + turn[i] - memory.left[i]
        along += weight * (step - memory.step[i] * interval_ratio)
        square += weight * rate[i]
        memory.left[i], memory.step[i] = turn[i] - correction[i], step
    for k in range(FRAMES - 1):
        memory.times_s[k] = memory.times_s[k + 1]
        memory.variances_s2[k] = memory.variances_s2[k + 1]
    memory.times_s[-1], memory.variances_s2[-1] = along / square, 1 / square
    return True, _stamp_variance(memory.times_s, memory.variances_s2), 1 / square


@compiled
def _stamp_variance(times_s: np.ndarray, variances_s2: np.ndarray) -> float:
    """Return s^2 out of the mean product of successive times, 0 where it is not significant."""
    limit = LIMIT_SIGMAS * 1.4826 * np.nanmedian(np.abs(times_s))
    product, products, noise, frames = 0.0, 0, 0.0, 0
    for k in range(FRAMES):
        if not math.isnan(variances_s2[k]):
            noise += variances_s2[k]
            frames += 1
        if k and math.isfinite(times_s[k] * times_s[k - 1]):
            product += (min(max(times_s[k], -limit), limit)
                        * min(max(times_s[k - 1], -limit), limit))
            products += 1
    if products < LEAST_PRODUCTS:
        return 0.0
    seen, noise = -product / products / 4, noise / frames
    return seen - noise if seen > (SIGNIFICANT + FEW / products) * noise else 0.0
