# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors of stamps, learnt from the frames of a body that turns.

A stamp that is late by d shows the body where it is not yet: a turn w d along its rate w, the
same for all stars. Frames stamped on arrival err by milliseconds, each by another time. Neither
residuals nor a smooth rate show that, but the attitudes a measured by the stars do. With the
second differences

    e_k = (a_k - a_k-1) - (a_k-1 - a_k-2) dt_k / dt_k-1

and R the covariance of a, t_k = w^T R^-1 e_k / (w^T R^-1 w) is the best estimate of their part
along the rate as a time, and the mean of t_k t_k-1 is -4 (r + s^2), r = 1 / (w^T R^-1 w), s the
standard deviation of the stamps. Changes of the rate make it zero or positive, so no manoeuvre is
mistaken for an error of the stamps. Times weigh by 1 / r: of a swinging body at its turning points
they say nothing.

A vibration moves the body to and fro as well. But where the filter predicts the next frame
(motion_filter.py), it is no error of a stamp. A camera that is shaken at random moves across its
rate as much as along it: with the part u_k of e_k that is across, as a time, s^2 is less by what
-u_k u_k-1 / 4 is more than r.

In the first frames the stamps may err by DOUBT_S: no more than the size of the few products so
far leaves room for, whatever their signs. From DOUBT_FRAMES on only what that size shows counts,
and their signs decide alone after twice as many. Stamps that have erred so far may go on to do
so: less is significant then, and what is known fades slowly.
"""

from collections import deque
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import STAMP_ERRORS
from startracker_ros.core.maths.compiled_rotation import rotation_between
from startracker_ros.core.maths.small_algebra import inverse
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

MEMORY = 0.95  # of the rates of the frames before
RECENT = 8  # frames of whose predictions the errors are known
PREDICTED = 6.0
"""Variance of a prediction of an oscillation by three attitudes, over that of one of them."""

FADES = 0.98  # from frame to frame, a variance that the last frames alone do not show
DOUBT_S, DOUBT_FRAMES = STAMP_ERRORS.limits['first_s'], STAMP_ERRORS.frames
"""What stamps of frames that are stamped on arrival err by, on a machine that is not loaded."""

MEAN_SIZE = 4.7
"""Mean size of a product of two times in a row, over the variance of one frame: 6 (2 / pi)
(sqrt(1 - c^2) + c asin c) of their correlation c = -2/3."""


class StampJitter:
    """
    Learns the standard deviation of the stamps, sigma_s, from good frames in turn.

    turn_rad (3,) is what it turns the body by, about sensor axes; both are zero where they are
    not significant.
    """

    def __init__(self) -> None:
        self.sigma_s = 0.0
        self.turn_rad = np.zeros(3)
        self._rate, self._frames = np.zeros(3), 0
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        self._differences = Differences.empty()
        self.interrupt()

    def interrupt(self) -> None:
        """Begin new differences: the frames before are no neighbours of the next one."""
        self._interval_s = math.nan
        self._differences.left.fill(math.nan)
        self._differences.step.fill(math.nan)

    def add(self, before: AttitudeState, predicted: AttitudeState, corrected: AttitudeState,
            turn: np.ndarray, R: np.ndarray) -> None:
        """
        Add a frame: the state of the frame before, the prediction, and the corrected one.

        turn (3,) from the prediction is what the stars measure, of covariance R (3, 3).
        """
        self._frames += 1
        self._rate = MEMORY * self._rate + (1 - MEMORY) * corrected.rate
        rate = self._rate / (1 - MEMORY ** self._frames)
        interval_s = (corrected.stamp_ns - before.stamp_ns) * 1e-9
        adds, learnt_s2, variance_s2 = add_frame(
            self._differences, before, predicted, corrected, turn, R,
            interval_s / self._interval_s,
            self._frames > DOUBT_FRAMES and bool(self.turn_rad.any()))
        if not adds:
            self.interrupt()
            return
        self._interval_s = interval_s
        # A few times that happen to agree do not end what many have shown.
        learnt_s2 = max(learnt_s2, FADES * self.sigma_s ** 2)
        self.sigma_s = math.sqrt(learnt_s2) if learnt_s2 > variance_s2 else 0.0
        # Errors of the stamps are errors of a prediction as well.
        along = np.linalg.solve(R, corrected.rate)
        speed2 = float(along @ corrected.rate)
        if speed2:
            self._recent.append((float(along @ turn) ** 2 / speed2 - PREDICTED, speed2))
        most_s = math.inf
        if self._frames > DOUBT_FRAMES and self._recent:
            excess, weight_s2 = np.sum(self._recent, axis=0)
            most_s = math.sqrt(max(excess, 0.0) / weight_s2)
        self.sigma_s = min(self.sigma_s, most_s)
        sigma_s = min(max(self.sigma_s, self._doubt_s()), most_s)
        self.turn_rad = (sigma_s * max(rate, corrected.rate, key=np.linalg.norm)
                         if sigma_s else np.zeros(3))

    def _doubt_s(self) -> float:
        """Return the standard deviation that the first frames do not exclude."""
        if self._frames > 2 * DOUBT_FRAMES:
            return 0.0
        times_s, variances_s2 = self._differences.times_s, self._differences.variances_s2
        products = np.abs(times_s[1:] * times_s[:-1])
        products = products[np.isfinite(products)]
        if not len(products):
            return DOUBT_S
        size_s2, noise_s2 = products.mean() / MEAN_SIZE, variances_s2[-1]
        if self._frames > DOUBT_FRAMES:
            return min(DOUBT_S, math.sqrt(max(size_s2 - 2 * noise_s2, 0.0)))
        # n products of two normal values are on average so much too small, in one case of twenty.
        least = 1 + 20 / len(products) ** 2
        return min(DOUBT_S, math.sqrt(least * (size_s2 + noise_s2)))


# --- the arithmetic of one frame: compiled ---

FRAMES = 20  # whose times are compared
LIMIT_SIGMAS = 2.5  # a longer time, as that of a jump of the rate, counts as this
LEAST_PRODUCTS, SIGNIFICANT, FEW, EXPECTED, SHAKEN = (
    STAMP_ERRORS.limits[name] for name in ('products', 'many', 'few', 'expected', 'shaken'))


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
def add_frame(memory: Differences, before: AttitudeState, predicted: AttitudeState,
              corrected: AttitudeState, turn: np.ndarray, R: np.ndarray, interval_ratio: float,
              expected: bool) -> tuple[bool, float, float]:
    """
    Add t_k of a frame to the memory; return the variance of the stamps and r, both s^2.

    With the turn (3,) from the prediction that the stars measure, its covariance R (3, 3) and the
    predicted rate w, as in stamp_jitter.py: r = 1 / (w^T R^-1 w), t_k = r w^T R^-1 e_k.
    interval_ratio is dt_k / dt_k-1, expected whether the stamps have erred so far. The first is
    False where there is no such attitude, or w is zero.
    """
    rate = predicted.rate
    if not rate.any():
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
