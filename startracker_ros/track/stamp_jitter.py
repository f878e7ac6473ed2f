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
mistaken for an error of the stamps.
"""

from collections import deque
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.attitude.attitude_state import AttitudeState
from startracker_ros.maths.rotation import attitude_error

MEMORY = 0.95  # of the frames before
FRAMES = 20  # whose times are compared
LIMIT_SIGMAS = 2.5  # a longer time, as that of a jump of the rate, counts as this
LEAST_PRODUCTS = 3
# Times the variance of the measured time by the centroids, of many products and of few.
SIGNIFICANT, FEW = 4.0, 20.0


class Measurement(NamedTuple):
    """
    What the stars of a frame add: the turn (3,) from the prediction, and its covariance.

    change (3,) is the turn from the prediction to the corrected attitude.
    """

    turn: np.ndarray
    covariance: np.ndarray
    change: np.ndarray

    @classmethod
    def of(cls, predicted: AttitudeState, corrected: AttitudeState) -> 'Measurement | None':
        """
        Return the measurement by which a prediction was corrected, None where it adds nothing.

        An update by attitude alone adds its information: Y = P+^-1 - P-^-1 of the attitude, and
        x+ - x- = P+ y. The measured turn is Y^-1 y, its covariance Y^-1.
        """
        information = np.linalg.inv(corrected.covariance[:3, :3])
        added = information - np.linalg.inv(predicted.covariance[:3, :3])
        covariance = np.linalg.inv((added + added.T) / 2)
        if not (np.linalg.eigvalsh(covariance) > 0).all():
            return None
        change = attitude_error(corrected.quaternion, predicted.quaternion)
        return cls(covariance @ (information @ change), covariance, change)


class StampJitter:
    """
    Learns the standard deviation of the stamps, sigma_s, from good frames in turn.

    turn_rad (3,) is what it turns the body by, about sensor axes; both are zero where they are
    not significant.
    """

    def __init__(self) -> None:
        self.sigma_s = 0.0
        self.turn_rad = np.zeros(3)
        self._times_s: deque[float] = deque(maxlen=FRAMES)
        self._variances_s2: deque[float] = deque(maxlen=FRAMES)
        self._rate, self._frames = np.zeros(3), 0
        self.interrupt()

    def interrupt(self) -> None:
        """Begin new differences: the frames before are no neighbours of the next one."""
        self._interval_s = math.nan
        self._left = self._step = np.full(3, math.nan)

    def add(self, before: AttitudeState, predicted: AttitudeState, corrected: AttitudeState,
            measured: Measurement | None) -> None:
        """Add a frame: the state of the frame before, the prediction, and the corrected one."""
        # The rate of one frame follows the error of its stamp.
        self._frames += 1
        self._rate = MEMORY * self._rate + (1 - MEMORY) * corrected.rate
        rate = self._rate / (1 - MEMORY ** self._frames)
        if measured is None or not rate.any():
            self.interrupt()
            return
        step = (attitude_error(predicted.quaternion, before.quaternion) + measured.turn
                - self._left)
        interval_s = (corrected.stamp_ns - before.stamp_ns) * 1e-9
        difference = step - self._step * (interval_s / self._interval_s)
        self._left = measured.turn - measured.change
        self._step, self._interval_s = step, interval_s
        weight = np.linalg.solve(measured.covariance, rate)
        variance_s2 = 1 / float(weight @ rate)
        self._times_s.append(float(weight @ difference) * variance_s2)
        self._variances_s2.append(variance_s2)
        # A few times that happen to agree do not end what many have shown.
        learnt_s2 = max(self._learnt_s2(), MEMORY * self.sigma_s ** 2)
        self.sigma_s = math.sqrt(learnt_s2) if learnt_s2 > variance_s2 else 0.0
        self.turn_rad = self.sigma_s * max(rate, corrected.rate, key=np.linalg.norm)

    def _learnt_s2(self) -> float:
        """Return the variance of the stamps, zero where it is not significant."""
        times_s, noise_s2 = np.array(self._times_s), float(np.mean(self._variances_s2))
        together = np.isfinite(times_s[1:] * times_s[:-1])
        if np.count_nonzero(together) < LEAST_PRODUCTS:
            return 0.0
        limit_s = LIMIT_SIGMAS * 1.4826 * np.nanmedian(np.abs(times_s))
        times_s = np.clip(times_s, -limit_s, limit_s)
        products_s2 = (times_s[1:] * times_s[:-1])[together]
        seen_s2 = -float(np.mean(products_s2)) / 4
        significant = seen_s2 > (SIGNIFICANT + FEW / len(products_s2)) * noise_s2
        return seen_s2 - noise_s2 if significant else 0.0
