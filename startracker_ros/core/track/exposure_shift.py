"""
Where the light of an exposure has its centre under an angular acceleration.

Under an acceleration a the stars are not seen where they were in the middle of an exposure T, but
a turn a T^2 / 24 away, the same for all of them: no residual shows it. The second differences of
the attitudes that the stars of single frames measure,

    a_k = (d_k / dt_k - d_k-1 / dt_k-1) / ((dt_k + dt_k-1) / 2),  d_k from frame k - 1 to k,

are mean accelerations about the time of frame k - 1. They predict the one at frame k in three
ways: a = 0 of a steady turn, a = a_k of a torque that lasts, and a = b a_k - a_k-1 of an
oscillation, b = 2 cos(w dt) by least squares. Each way has its mean squared error in the frames
before (covariance matching): the best one is used, and what its error exceeds the noise of the
centroids by is the variance of the acceleration. In a steady turn that is next to nothing.

An oscillation of angular frequency w is seen smaller by sinc(w T / 2) in the light and by
sinc(w dt / 2)^2 in the differences, which b gives. Fits of streaks see the acceleration along the
motion by their ends, which are a T^2 / 8 away, the more the longer they are.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.compiled_quaternion import rotation_between

MEMORY = 0.93  # of the squared errors of the frames before
_STEADY, _TORQUE, _OSCILLATION = range(3)
_HISTORY = 3  # accelerations
_NOISE = np.array([1.0, -2.0, 1.0])
"""Weights of the measured attitudes of three frames in a second difference."""

STREAK_PX = 15.0
"""Length of a streak from which on a fit sees rather its ends; computed for a width of 1 px."""

STREAK_DOUBT = 0.25  # of the acceleration along streaks: bright stars show it in another way


class Shift(NamedTuple):
    """The turn (3,) rad of the light from the middle of the exposure, its covariance (3, 3)."""

    turn: np.ndarray
    covariance: np.ndarray


_NONE = Shift(np.zeros(3), np.zeros((3, 3)))


class ExposureShift:
    """
    Estimates the angular acceleration from good frames in turn, and what it does to the light.

    acceleration (3,) rad/s^2 is that at the last frame about sensor axes, variance (3,) its own.
    """

    def __init__(self) -> None:
        self.interrupt()

    def interrupt(self) -> None:
        """Begin anew: the frames before are no neighbours of the next one."""
        self._attitude: tuple[int, np.ndarray] | None = None
        self._rate: np.ndarray | None = None
        self._recent: list[np.ndarray] = []
        self._predicted: np.ndarray | None = None
        self._weight = 0.0
        self._square = np.zeros((3, 3))
        self._product, self._energy = 0.0, 0.0
        self._b, self._dt_s = 2.0, math.nan
        self.acceleration, self.variance = np.zeros(3), np.zeros(3)
        self._kind = _STEADY

    def start(self, stamp_ns: int, quaternion: np.ndarray, rate_rad_s: np.ndarray) -> None:
        """Begin with the attitude (4,) of a frame and the mean rate (3,) since the one before."""
        self.interrupt()
        self._attitude, self._rate = (stamp_ns, quaternion), rate_rad_s

    def add(self, stamp_ns: int, quaternion: np.ndarray, variance: np.ndarray) -> None:
        """Add the attitude (4,) that the stars of a frame measure, with variance (3,) rad^2."""
        attitude, before = self._attitude, self._rate
        self._attitude = stamp_ns, quaternion
        if attitude is None:
            return
        before_s, dt_s = self._dt_s, (stamp_ns - attitude[0]) * 1e-9
        self._dt_s, self._rate = dt_s, rotation_between(attitude[1], quaternion) / dt_s
        if before is None:
            return
        middle_s = dt_s if math.isnan(before_s) else (dt_s + before_s) / 2
        acceleration = (self._rate - before) / middle_s
        noise = variance / dt_s ** 4
        predicted = self._predictions()
        self._weight = MEMORY * self._weight + 1
        self._square = MEMORY * self._square + (acceleration - predicted) ** 2
        if len(self._recent) == _HISTORY - 1:
            last, oldest = self._recent[-1], self._recent[-2]
            self._product = MEMORY * self._product + float(
                (last * (acceleration + oldest) / noise).sum())
            self._energy = MEMORY * self._energy + float((last * last / noise).sum())
            self._b = min(max(self._product / self._energy, -2.0), 2.0)
        self._recent = [*self._recent[1 - _HISTORY + 1:], acceleration]
        self._choose(noise)

    def _predictions(self) -> np.ndarray:
        """Return the acceleration (3, 3) at the next difference by each of the ways."""
        zero = np.zeros(3)
        last = self._recent[-1] if self._recent else zero
        swung = self._b * last - self._recent[-2] if len(self._recent) > 1 else last
        return np.stack([zero, last, swung])

    def _choose(self, noise: np.ndarray) -> None:
        """Use the way with the least errors so far; noise (3,) is that of an attitude over dt^4."""
        weights = (np.zeros(4), np.array([1.0, -2, 1, 0]),
                   self._b * np.array([1.0, -2, 1, 0]) - [0, 1, -2, 1])
        variances = []
        for own, square in zip(weights, self._square):
            # The error that was measured is that of the next difference and of its prediction.
            measured = np.append(_NOISE, [0.0, 0.0]) - np.append(0.0, own)
            chance = float(measured @ measured) * noise
            variances.append(np.maximum(square / self._weight - chance, 0.0)
                             + float(own @ own) * noise + math.sqrt(2 / self._weight) * chance)
        self._kind = int(np.argmin([(variance / noise).sum() for variance in variances]))
        self.variance = variances[self._kind]
        self.acceleration = self._predictions()[self._kind]

    def shift(self, exposure_s: tuple[float, float], rate: np.ndarray, focal_px: float) -> Shift:
        """
        Return the shift of the light at the last frame.

        exposure_s are the least and the largest exposure, which the frame interval limits; rate
        (3,) rad/s is that of the body, focal_px the focal length.
        """
        if not self._weight:
            return _NONE
        low, high = (self._seconds2(min(limit, self._dt_s)) for limit in exposure_s)
        mean, doubt = (low + high) / 2, (high - low) / 2
        a, speed = self.acceleration, float(np.linalg.norm(rate))
        along = rate * (a @ rate) / speed ** 2 if speed else np.zeros(3)
        length_px = focal_px * math.hypot(rate[0], rate[1]) * min(exposure_s[1], self._dt_s)
        long = 1 / (1 + (STREAK_PX / max(length_px, 1e-9)) ** 2)
        seen = a + 2 * long * along
        uncertain = STREAK_DOUBT * min(length_px / 4, 1.0) * mean * along
        return Shift(mean * seen, np.diag((mean ** 2 + doubt ** 2) * self.variance)
                     + doubt ** 2 * np.outer(seen, seen) + np.outer(uncertain, uncertain))

    def _seconds2(self, exposure_s: float) -> float:
        """Return the shift over the acceleration of the differences: T^2 / 24, unless it swings."""
        if self._kind != _OSCILLATION:
            return exposure_s ** 2 / 24
        half = math.asin(math.sqrt((2 - self._b) / 4))  # w dt / 2
        if half < 0.05:
            return exposure_s ** 2 / 24
        light = half * exposure_s / self._dt_s  # w T / 2
        w = 2 * half / self._dt_s
        return (light / math.sin(light) - 1 if light else 0.0) / w ** 2 * (
            half / math.sin(half)) ** 2
