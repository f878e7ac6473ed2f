"""
The angular acceleration, and what it does to the light of an exposure.

Under an acceleration a the stars are not seen where they were in the middle of an exposure T, but
a turn a T^2 / 24 away, the same for all of them: no residual shows it. The second differences of
the attitudes that the stars of single frames measure,

    a_k = (d_k / dt_k - d_k-1 / dt_k-1) / ((dt_k + dt_k-1) / 2),  d_k from frame k - 1 to k,

are mean accelerations about the time of frame k - 1. They predict the one at frame k in three
ways: a = 0 of a steady turn, a = a_k of a torque that lasts, and a = b a_k - a_k-1 of an
oscillation, b = 2 cos(w dt) by least squares. Each way has its mean squared error in the frames
before (covariance matching), and what this exceeds the noise of the centroids by is the variance
of the acceleration. The way of the least variance is used. In a steady turn that is next to none.

An oscillation of angular frequency w is seen smaller by sinc(w T / 2) in the light and by
sinc(w dt / 2)^2 in the differences, which b gives. Fits of streaks see the acceleration along the
motion by their ends, which are a T^2 / 8 away, the more the longer they are.

Where the rate jumps within an exposure the light is up to the whole innovation away from the
attitude, and the difference to the frame after has another part of the jump.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.compiled_quaternion import rotation_between

MEMORY = 0.93  # of the squared errors of the frames before
SIGNIFICANT = 3.0  # standard deviations of a mean squared error by chance
_STEADY, _TORQUE, _OSCILLATION = range(3)
_DIFFERENCE = np.array([1.0, -2.0, 1.0, 0.0])
"""Weights of the attitudes of four frames, the newest first, in a second difference."""

STREAK_PX = 15.0
"""Length of a streak from which on a fit sees rather its ends; computed for a width of 1 px."""

STREAK_DOUBT = 0.25  # of the acceleration along streaks: bright stars show it in another way
LEAST_WEIGHT = 5.0  # frames from which on a jump is told from a motion that has begun
JUMP_FRAMES = 5  # after a jump, in which there is no other one
UNSTEADY = 0.15
"""Of what the body moves by from frame to frame and no frames before show, as of a vibration: the
fit of a star whose light that spreads within the exposure is off by as much, 1 sigma."""

PEAK_MEMORY, PEAK_SIGMAS = 0.97, 6.0
"""What was wrong once in an error of the prediction may be again: it is so many sigma."""

JUMP_DOUBT = 0.3  # of the innovation by a jump of the rate, 1 sigma


class Shift(NamedTuple):
    """The turn (3,) rad of the light from the middle of the exposure, its covariance (3, 3)."""

    turn: np.ndarray
    covariance: np.ndarray


class AngularAcceleration:
    """
    Estimates the acceleration from good frames in turn.

    value (3,) rad/s^2 is that at the last frame about sensor axes; process (3,) the variance of
    it that is significant, for the process noise of a filter.
    """

    def __init__(self) -> None:
        self._dt_s = math.nan
        self._weight, self._square, self._peak = 0.0, np.zeros((3, 3)), np.zeros((3, 3))
        self._product, self._energy = 0.0, 0.0
        self._b, self._b_sigma = 2.0, 0.0
        self._since_jump = JUMP_FRAMES
        self.process, self._variance, self._unsteady = np.zeros(3), np.zeros(3), np.zeros(3)
        self.interrupt()

    def interrupt(self) -> None:
        """Begin new differences; how the body moved before is not forgotten."""
        self._attitude: tuple[int, np.ndarray] | None = None
        self._rate: np.ndarray | None = None
        self._recent: list[np.ndarray] = []
        self._jump, self.value, self._way = np.zeros(3), np.zeros(3), _STEADY
        if self._weight:
            self._variance = self.process = self._square[_STEADY] / self._weight

    def start(self, stamp_ns: int, quaternion: np.ndarray, rate_rad_s: np.ndarray) -> None:
        """Begin by the attitude (4,) of a frame and the mean rate (3,) since the one before."""
        self._attitude, self._rate = (stamp_ns, quaternion), rate_rad_s

    def add(self, stamp_ns: int, quaternion: np.ndarray, variance: np.ndarray,
            jump: np.ndarray | None = None) -> None:
        """
        Add the attitude (4,) that the stars of a frame measure, with variance (3,) rad^2.

        jump (3,) rad is its turn from a prediction that it contradicts.
        """
        attitude, before = self._attitude, self._rate
        self._attitude = stamp_ns, quaternion
        if attitude is None:
            return
        before_s, dt_s = self._dt_s, (stamp_ns - attitude[0]) * 1e-9
        self._dt_s, self._rate = dt_s, rotation_between(attitude[1], quaternion) / dt_s
        if before is None:
            return
        middle_s = dt_s if math.isnan(before_s) else (dt_s + before_s) / 2
        acceleration, noise = (self._rate - before) / middle_s, variance / dt_s ** 4
        self._since_jump += 1
        jumps = jump is not None and self._since_jump > JUMP_FRAMES
        if jumps:
            self._since_jump = 0
        self._jump = jump if jumps and jump is not None else np.zeros(3)
        errors = acceleration - self._predictions()
        # Two differences have a part of a jump, and no other one will.
        if self._since_jump > 1 or self._weight < LEAST_WEIGHT:
            self._weight = MEMORY * self._weight + 1
            self._square = MEMORY * self._square + errors ** 2
            self._peak = np.maximum(PEAK_MEMORY * self._peak, np.abs(errors))
        self._fit_oscillation(acceleration, noise)
        self._recent = [*self._recent[-1:], acceleration]
        self._choose(noise)
        if self._since_jump == 1:
            # The rest of a jump, or a torque that has begun.
            self._variance = self._variance + acceleration ** 2

    def _fit_oscillation(self, acceleration: np.ndarray, noise: np.ndarray) -> None:
        """Fit b by a_k + a_k-2 = b a_k-1."""
        if len(self._recent) < 2:
            return
        oldest, last = self._recent
        self._product = MEMORY * self._product + float(
            (last * (acceleration + oldest) / noise).sum())
        self._energy = MEMORY * self._energy + float((last * last / noise).sum())
        self._b = min(max(self._product / self._energy, -2.0), 2.0)
        error = float((self._square[_OSCILLATION] / noise).sum())
        self._b_sigma = math.sqrt(error / max(self._weight, 1.0) / self._energy)

    def _predictions(self) -> np.ndarray:
        """Return the acceleration (3, 3) at the next difference by each of the ways."""
        last = self._recent[-1] if self._recent else np.zeros(3)
        swung = self._b * last - self._recent[0] if len(self._recent) > 1 else last
        return np.stack([np.zeros(3), last, swung])

    def _choose(self, noise: np.ndarray) -> None:
        """Use the way with the least variance; noise (3,) is that of an attitude over dt^4."""
        weights = (np.zeros(4), _DIFFERENCE, self._b * _DIFFERENCE - np.roll(_DIFFERENCE, 1))
        variances = []
        for own, square in zip(weights, self._square):
            # The error that was measured is that of the next difference and of its prediction.
            measured = np.append(_DIFFERENCE, 0.0) - np.append(0.0, own)
            chance = float(measured @ measured) * noise
            excess = square / self._weight - chance
            variances.append((excess, chance, float(own @ own) * noise))
        totals = [np.maximum(excess, 0.0) + own + 2 / self._weight * chance
                  for excess, chance, own in variances]
        self._way = int(np.argmin([float((total / noise).sum()) for total in totals]))
        excess, chance, own = variances[self._way]
        self._variance = np.maximum(totals[self._way], np.maximum(
            self._peak[self._way] ** 2 - 16 * chance, 0.0) / PEAK_SIGMAS ** 2)
        self.value = self._predictions()[self._way]
        limit = SIGNIFICANT * math.sqrt(2 / self._weight) * chance
        significant = np.maximum(excess - limit, 0.0)
        self.process = significant if self._way == _STEADY else np.maximum(excess, 0.0) + own
        self._unsteady = significant * np.minimum(
            significant * self._weight / np.maximum(self._square[_STEADY], 1e-300), 1.0)

    def shift(self, exposure_s: tuple[float, float], rate: np.ndarray, focal_px: float) -> Shift:
        """
        Return the shift of the light at the last frame.

        exposure_s are the least and the largest exposure, which the frame interval limits; rate
        (3,) rad/s is that of the body, focal_px the focal length.
        """
        if math.isnan(self._dt_s):
            return Shift(np.zeros(3), np.zeros((3, 3)))
        least, most = (min(limit, self._dt_s) for limit in exposure_s)
        low = self._seconds2(least, self._b + self._b_sigma)
        high = self._seconds2(most, self._b - self._b_sigma)
        mean, doubt = (low + high) / 2, (high - low) / 2
        speed2 = float(rate @ rate)
        along = rate * (self.value @ rate) / speed2 if speed2 else np.zeros(3)
        length_px = focal_px * math.hypot(rate[0], rate[1]) * most
        long = 1 / (1 + (STREAK_PX / max(length_px, 1e-9)) ** 2)
        seen = self.value + long * along
        uncertain = (STREAK_DOUBT * min(length_px / 4, 1.0) + long) * mean * along
        unsteady_s4 = UNSTEADY ** 2 * most * self._dt_s ** 3
        return Shift(mean * seen, np.diag((mean ** 2 + doubt ** 2) * self._variance
                                          + unsteady_s4 * self._unsteady)
                     + doubt ** 2 * np.outer(seen, seen) + np.outer(uncertain, uncertain)
                     + JUMP_DOUBT ** 2 * most / self._dt_s * np.outer(self._jump, self._jump))

    def _seconds2(self, exposure_s: float, b: float) -> float:
        """Return the shift over the acceleration of the differences: T^2 / 24, if it is slow."""
        half = (math.asin(math.sqrt(min(max((2 - b) / 4, 0.0), 1.0)))  # w dt / 2
                if self._way == _OSCILLATION else 0.0)
        light = half * exposure_s / self._dt_s  # w T / 2
        if light < 0.01:
            return exposure_s ** 2 / 24
        w = 2 * half / self._dt_s
        return (light / math.sin(light) - 1) / w ** 2 * (half / math.sin(half)) ** 2
