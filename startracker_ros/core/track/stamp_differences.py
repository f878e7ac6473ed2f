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
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

FRAMES = 20  # whose times are compared
LIMIT_SIGMAS = 2.5  # a longer time, as that of a jump of the rate, counts as this
LEAST_PRODUCTS = 3
# Times the variance of the measured time by the centroids, of many products and of few.
SIGNIFICANT, FEW = 2.5, 15.0
EXPECTED = 2.0  # the same once the stamps have erred, or may do
SHAKEN = 2.0  # times what a camera that shakes moves across its rate as well


class Differences(NamedTuple):
    """
    What is remembered of the frames before; the arrays are changed in place.

    left (3,) is the correction minus the measured turn of the last frame, with the sign reversed;
    step (3,) the measured turn between the last two; times_s and variances_s2 (FRAMES,) are t_k
    and r of the newest frames, across_s (2, FRAMES) their u_k; NaN in front of the first one.
    """

    left: np.ndarray
    step: np.ndarray
    times_s: np.ndarray
    variances_s2: np.ndarray
    across_s: np.ndarray

    @classmethod
    def empty(cls) -> 'Differences':
        """Return those before the first frame."""
        return cls(np.full(3, np.nan), np.full(3, np.nan), np.full(FRAMES, np.nan),
                   np.full(FRAMES, np.nan), np.full((2, FRAMES), np.nan))


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
              corrected: AttitudeState, measured: AttitudeState, interval_ratio: float,
              expected: bool) -> tuple[bool, float, float]:
    """
    Add t_k of a frame to the memory; return the variance of the stamps and r, both s^2.

    With the attitude a_k that measured has beside the prediction, its covariance R and the
    predicted rate w, as in stamp_jitter.py: r = 1 / (w^T R^-1 w), t_k = r w^T R^-1 e_k.
    interval_ratio is dt_k / dt_k-1, expected whether the stamps have erred so far. The first is
    False where there is no such attitude, or w is zero.
    """
    rate = predicted.rate
    adds, turn, R = measured_turn(predicted, measured)
    if not adds or not rate.any():
        return False, np.nan, np.nan
    between = rotation_between(before.quaternion, predicted.quaternion)
    correction = rotation_between(predicted.quaternion, corrected.quaternion)
    information = inverse(R)
    along, square, difference = 0.0, 0.0, np.zeros(3)
    for i in range(3):
        weight = 0.0
        for j in range(3):
            weight += information[i, j] * rate[j]
        step = between[i] + turn[i] - memory.left[i]
        difference[i] = step - memory.step[i] * interval_ratio
        along += weight * difference[i]
        square += weight * rate[i]
        memory.left[i], memory.step[i] = turn[i] - correction[i], step
    for k in range(FRAMES - 1):
        memory.times_s[k] = memory.times_s[k + 1]
        memory.variances_s2[k] = memory.variances_s2[k + 1]
        for axis in range(2):
            memory.across_s[axis, k] = memory.across_s[axis, k + 1]
    memory.times_s[-1], memory.variances_s2[-1] = along / square, 1 / square
    # One of x and y is across the rate, or both are.
    axes = 1 + rate[2] ** 2 / (rate @ rate)
    for axis in range(2):
        memory.across_s[axis, -1] = (difference[axis] - rate[axis] * along / square) / math.sqrt(
            axes * (rate @ rate))
    return True, _stamp_variance(memory, expected), 1 / square


@compiled
def _stamp_variance(memory: Differences, expected: bool) -> float:
    """Return s^2 out of the mean product of successive times, 0 where it is not significant."""
    seen, noise, products = white_variance(memory.times_s, memory.variances_s2)
    if products < LEAST_PRODUCTS:
        return 0.0
    least = EXPECTED if expected else SIGNIFICANT
    significant, shaken = (least + FEW / products) * noise, 0.0
    for axis in range(2):
        shaken += white_variance(memory.across_s[axis], memory.variances_s2)[0]
    shaken = shaken - noise if shaken > significant else 0.0
    if seen <= significant + SHAKEN * shaken:
        return 0.0
    return seen - noise - shaken


@compiled
def white_variance(times_s: np.ndarray, variances_s2: np.ndarray) -> tuple[float, float, int]:
    """Return r + s^2 by times (FRAMES,), the mean r of variances (FRAMES,), and the products."""
    limit = LIMIT_SIGMAS * SIGMA_PER_MAD * np.nanmedian(np.abs(times_s))
    product, noise, total, products = 0.0, 0.0, 0.0, 0
    for k in range(1, FRAMES):
        if math.isfinite(times_s[k] * times_s[k - 1]):
            # Where the body hardly turns a time says little.
            weight = 1 / (variances_s2[k] * variances_s2[k - 1])
            product += weight * (min(max(times_s[k], -limit), limit)
                                 * min(max(times_s[k - 1], -limit), limit))
            noise += math.sqrt(weight)
            total += weight
            products += 1
    if not products:
        return 0.0, 0.0, 0
    return -product / total / 4, noise / total, products
