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

A vibration moves the body to and fro as well. But where the differences of the frames before
predict the next one (acceleration.py), it is no error of a stamp. A camera that is shaken at
random moves across its rate as much as along it: with the part u_k of e_k that is across, as a
time, s^2 is less by what -u_k u_k-1 / 4 is more than r.

In the first frames the stamps may err by DOUBT_S: no more than the size of the few products so
far leaves room for, whatever their signs. From DOUBT_FRAMES on only what that size shows counts,
and their signs decide alone after twice as many. Stamps that have erred so far may go on to do
so: less is significant then, and what is known fades slowly.
"""

import math

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.track.stamp_differences import add_frame, Differences

MEMORY = 0.95  # of the rates of the frames before
FADES = 0.98  # from frame to frame, a variance that the last frames alone do not show
DOUBT_S, DOUBT_FRAMES = 5e-3, 10
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
        self._rate, self._square, self._frames = np.zeros(3), np.zeros(3), 0
        self._differences = Differences.empty()
        self.interrupt()

    def interrupt(self) -> None:
        """Begin new differences: the frames before are no neighbours of the next one."""
        self._interval_s = math.nan
        self._differences.left.fill(math.nan)
        self._differences.step.fill(math.nan)

    def add(self, before: AttitudeState, predicted: AttitudeState, corrected: AttitudeState,
            measured: AttitudeState, white_rad2: np.ndarray) -> None:
        """
        Add a frame: the state of the frame before, the prediction, and the corrected one.

        measured is the latter without errors that all stars share; white_rad2 (3,) is the largest
        variance of errors that are another one in each frame.
        """
        self._frames += 1
        self._rate = MEMORY * self._rate + (1 - MEMORY) * corrected.rate
        self._square = MEMORY * self._square + (1 - MEMORY) * corrected.rate ** 2
        rate = self._rate / (1 - MEMORY ** self._frames)
        interval_s = (corrected.stamp_ns - before.stamp_ns) * 1e-9
        adds, learnt_s2, variance_s2 = add_frame(
            self._differences, before, predicted, corrected, measured,
            interval_s / self._interval_s,
            self._frames > DOUBT_FRAMES and bool(self.turn_rad.any()))
        if not adds:
            self.interrupt()
            return
        self._interval_s = interval_s
        # A few times that happen to agree do not end what many have shown.
        learnt_s2 = max(learnt_s2, FADES * self.sigma_s ** 2)
        self.sigma_s = math.sqrt(learnt_s2) if learnt_s2 > variance_s2 else 0.0
        most_s = self._most_s(white_rad2, np.diagonal(measured.covariance)[:3])
        self.sigma_s = min(self.sigma_s, most_s)
        sigma_s = min(max(self.sigma_s, self._doubt_s()), most_s)
        self.turn_rad = (sigma_s * max(rate, corrected.rate, key=np.linalg.norm)
                         if sigma_s else np.zeros(3))

    def _most_s(self, white_rad2: np.ndarray, variance: np.ndarray) -> float:
        """Return the largest standard deviation that errors (3,) of attitudes leave room for."""
        square = self._square / (1 - MEMORY ** self._frames)
        return math.sqrt((white_rad2 / variance).sum() / (square / variance).sum())

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
