# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

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
sinc(w dt / 2)^2 in the differences, which b gives. The next attitude and rate of the filter are
those of the oscillation, not of a constant acceleration. Fits of streaks see the acceleration
along the motion by their ends, which are a T^2 / 8 away, the more the longer they are.

Where the rate jumps within an exposure the light is up to the whole innovation away from the
attitude: after the middle of the exposure a jump moves the light alone. The difference to the
frame after has another part of the jump.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import rotation_between
from startracker_ros.core.maths.small_algebra import inverse
from startracker_ros.core.track.rate_jumps import tail_sigmas

MEMORY = 0.93  # of the squared errors of the frames before
SIGNIFICANT = 5.0  # standard deviations of a mean squared error by chance, of few frames
STEADY, TORQUE, OSCILLATION = 0, 1, 2
DIFFERENCE = (0.0, 1.0, -2.0, 1.0, 0.0)
"""Weights of attitudes in the newest second difference: of the next frame, and of four before."""

FRAMES, WEIGHT, FITTED, B, B_SIGMA = 0, 1, 2, 3, 4
"""Numbers of a Memory: differences in a row; weight of the squares, and of the sums; b."""

BOTH, PRODUCT, ENERGY = 0, 1, 2
"""Sums of the fit of b: of (a_k + a_k-2)^2, of a_k-1 (a_k + a_k-2) and of a_k-1^2."""

STREAK_PX = 15.0
"""Length of a streak from which on a fit sees rather its ends; computed for a width of 1 px."""

STREAK_DOUBT = 0.25  # of the acceleration along streaks: bright stars show it in another way
FIRST_WEIGHT = 5.0  # frames to which b is fitted at once
LEAST_WEIGHT = 5.0  # frames from which on a jump differs from a motion that has started
JUMP_FRAMES = 5  # after a jump more probable than not, in which there is no other one
LEAST_B = -1.0  # of an oscillation that is predicted ahead: three frames in a period
ALIAS_B = 0.0
"""Four frames in a period: a faster oscillation may as well be that of a vibration faster than
the frames, which the light shows as its mean and no shift corrects."""
SLOWEST = 1 - 1e-7  # cosine of its angle from frame to frame: a period of 14000
SURE_SIGMAS = 2.0  # of an acceleration that is used for the prediction
ENDS = 0.25  # of an acceleration, 1 sigma: a torque ends at some time without a sign before
UNSTEADY = 0.15
"""Of what the body moves by from frame to frame and no frames before show, as of a vibration: the
fit of a star whose light that spreads within the exposure is off by as much, 1 sigma."""

WHITE_SIGMAS = 2.0
"""Standard deviations of a mean squared error by chance, beyond which single attitudes err."""

WHITE_WEIGHT = 7.0  # frames from which on errors of single attitudes have a limit
SLOW_B = 1.8  # 14 frames in a period: a slower oscillation may be a torque, which may end
ROOM_SIGMAS = 3.0  # of the normal distribution, of chi-square that is too small by chance

MISSED = 1e-3
"""Probability of an error by a jump beyond those sigma that is left to chance: most frames have
no jump."""

PEAK_MEMORY, PEAK_SIGMAS = 0.97, 6.0
"""What was wrong once in an error of the prediction may be again: it is so many sigma."""


class Memory(NamedTuple):
    """
    What is remembered of the frames before; the arrays are changed in place.

    recent (2, 3) are the last two accelerations, the newest first; square and peak (3, 3) are the
    sum of the squared errors and the largest error of each way about each axis; sums (3, 3) are
    those of the fit of b about each axis; numbers (5,).
    """

    recent: np.ndarray
    square: np.ndarray
    peak: np.ndarray
    sums: np.ndarray
    numbers: np.ndarray

    @classmethod
    def empty(cls) -> 'Memory':
        """Return that before the first frame."""
        return cls(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)),
                   np.array([0.0, 0.0, 0.0, 2.0, 0.0]))


class Estimate(NamedTuple):
    """
    The acceleration at a frame about sensor axes, each (3,): its value in the way that is used.

    Up to the next frame the body turns as under the constant acceleration ahead, and its rate
    changes as by the constant acceleration mean, both zero where they are not sure: a swinging
    body has another one by then. variance is that of value, in rad^2/s^4; process the part of it
    that is significant, for the process noise of a filter; unsteady what of that no way predicts.
    white is the largest variance, in rad^2/s^4, of errors of single attitudes over dt^2, another
    one in each frame, that the errors of an oscillation leave room for, infinity without one.
    """

    way: int
    value: np.ndarray
    ahead: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    process: np.ndarray
    unsteady: np.ndarray
    white: np.ndarray


class Shift(NamedTuple):
    """
    The turn (3,) rad of the light from the middle of the exposure, its covariance (3, 3).

    share is the part of the error of the last attitude that is in the turn as well.
    """

    turn: np.ndarray
    covariance: np.ndarray
    share: float


_NOTHING = Estimate(STEADY, *[np.zeros(3)] * 7)


class AngularAcceleration:
    """Estimates the acceleration from good frames in turn; estimate is that at the last one."""

    def __init__(self) -> None:
        self._dt_s = math.nan
        self._memory = Memory.empty()
        self._since_jump = JUMP_FRAMES
        self.estimate = _NOTHING
        self.interrupt()

    def interrupt(self) -> None:
        """Begin new differences; how the body moved before is not forgotten."""
        self._attitude: tuple[int, np.ndarray] | None = None
        self._rate: np.ndarray | None = None
        self._jump, self._probability = np.zeros((3, 3)), 0.0
        memory = self._memory
        memory.numbers[FRAMES] = 0.0
        if memory.numbers[WEIGHT]:
            variance = memory.square[STEADY] / memory.numbers[WEIGHT]
            self.estimate = Estimate(
                STEADY, np.zeros(3), np.zeros(3), np.zeros(3), variance, variance,
                self.estimate.unsteady, self.estimate.white)

    def start(self, stamp_ns: int, quaternion: np.ndarray, rate_rad_s: np.ndarray) -> None:
        """Begin by the attitude (4,) of a frame and the mean rate (3,) since the one before."""
        self._attitude, self._rate = (stamp_ns, quaternion), rate_rad_s

    def add(self, stamp_ns: int, quaternion: np.ndarray, covariance: np.ndarray,
            jump: np.ndarray = np.zeros(3), probability: float = 0.0) -> None:
        """
        Add the attitude (4,) that the stars of a frame measure, of covariance (3, 3) rad^2.

        jump (3,) rad is its turn from the prediction, by a jump of the rate with this probability.
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
        self._since_jump += 1
        self._jump, self._probability = np.zeros((3, 3)), 0.0
        if self._since_jump > JUMP_FRAMES:
            self._jump, self._probability = probability * jump[:, None] * jump, probability
            if probability > 0.5:
                self._since_jump = 0
        self.estimate = Estimate(*add_difference(
            self._memory, (self._rate - before) / middle_s, covariance / dt_s ** 4,
            self._since_jump))

    @property
    def rate_change(self) -> np.ndarray:
        """Change (3,) rad/s of the mean rate in the last interval, zero where it is not known."""
        memory = self._memory
        return memory.recent[0] * self._dt_s if memory.numbers[FRAMES] else np.zeros(3)

    @property
    def lasts_s(self) -> float:
        """Return the time in which an acceleration changes by its own size, 1 sigma."""
        return math.inf if math.isnan(self._dt_s) else self._dt_s / ENDS

    @property
    def is_known(self) -> bool:
        """Whether enough frames have shown how the body accelerates."""
        return bool(self._memory.numbers[WEIGHT] >= LEAST_WEIGHT)

    @property
    def white_rad2(self) -> np.ndarray:
        """Return the largest variance (3,) of errors of attitudes, another one in each frame."""
        return self.estimate.white * self._dt_s ** 4 if self.is_known else np.full(3, np.inf)

    def jump_within(self, exposed_s: float, hidden: float = 0.0) -> float:
        """
        Return the probability of a jump of the rate while the last frame was exposed, in s.

        hidden is that of one since the frame before, by another measure.
        """
        if math.isnan(self._dt_s):
            return 0.0
        return max(self._probability, hidden) * min(exposed_s / self._dt_s, 1.0)

    def shift(self, exposure_s: tuple[float, float], rate: np.ndarray, focal_px: float,
              rows_s2: float = 0.0, known: np.ndarray = np.zeros(3)) -> Shift:
        """
        Return the shift of the light at the last frame.

        exposure_s are the least and the largest exposure, which the frame interval limits; rate
        (3,) rad/s is that of the body, focal_px the focal length, zero where the centroids are no
        fits of streaks: those are at the centre of the light. Of a rolling shutter an acceleration
        moves the stars by rows_s2 of it, half the mean square of their times, beside the known one
        (3,), by which they are at the time of the frame.
        """
        if math.isnan(self._dt_s):
            return Shift(np.zeros(3), np.zeros((3, 3)), 0.0)
        least, most = (min(limit, self._dt_s) for limit in exposure_s)
        return Shift(*light_shift(self._memory, self.estimate, self._jump, self._dt_s, least, most,
                                  rate, focal_px, rows_s2, known))


@compiled
def add_difference(memory: Memory, acceleration: np.ndarray, noise: np.ndarray, since_jump: int
                   ) -> tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray,
                              np.ndarray, np.ndarray]:
    """
    Add a difference (3,) of attitudes of covariance noise (3, 3) over dt^4; return an Estimate.

    It is since_jump frames after a jump. The ways predict by weights of the attitudes before; the
    error that is measured is that of the next difference and of its prediction.
    """
    recent, square, peak, sums, numbers = memory
    frames, b = int(numbers[FRAMES]), numbers[B]
    known = since_jump > 1 or numbers[WEIGHT] < LEAST_WEIGHT
    if known:
        # Two differences have a part of a jump, and no other one will.
        numbers[WEIGHT] = MEMORY * numbers[WEIGHT] + 1
    fits = frames > 1 and since_jump > 3
    if fits:
        numbers[FITTED] = MEMORY * numbers[FITTED] + 1
    for axis in range(3):
        a, last, oldest = acceleration[axis], recent[0, axis], recent[1, axis]
        if frames < 1:
            last = 0.0
        for way in range(3):
            error = a
            if way == TORQUE or way == OSCILLATION and frames < 2:
                error -= last
            elif way == OSCILLATION:
                error -= b * last - oldest
            if known:
                square[way, axis] = MEMORY * square[way, axis] + error * error
                # The first errors are those of a motion that is not known yet.
                if numbers[WEIGHT] >= LEAST_WEIGHT:
                    peak[way, axis] = max(PEAK_MEMORY * peak[way, axis], abs(error))
        if fits:
            both = a + oldest
            sums[BOTH, axis] = MEMORY * sums[BOTH, axis] + both * both
            sums[PRODUCT, axis] = MEMORY * sums[PRODUCT, axis] + last * both
            sums[ENERGY, axis] = MEMORY * sums[ENERGY, axis] + last * last
        recent[1, axis], recent[0, axis] = last, a
    if numbers[FITTED] > 1:
        _fit_oscillation(memory, noise)
    numbers[FRAMES] = frames + 1
    return _best_way(memory, noise, since_jump)


@compiled
def _fit_oscillation(memory: Memory, noise: np.ndarray) -> None:
    """
    Fit b, and in the first frames set the squared errors of that way to those with this b.

    Those by the b of the frames before are of a motion that was not known yet.
    """
    _, square, _, sums, numbers = memory
    product = energy = error = 0.0
    for axis in range(3):
        product += sums[PRODUCT, axis] / noise[axis, axis]
        energy += sums[ENERGY, axis] / noise[axis, axis]
    b = numbers[B] = min(max(product / energy, -2.0), 2.0)
    # A body that swings about one axis fits one b to as many values.
    weight = numbers[WEIGHT] / (numbers[FITTED] - 1)
    for axis in range(3):
        if numbers[FITTED] <= FIRST_WEIGHT:
            square[OSCILLATION, axis] = weight * max(
                sums[BOTH, axis] - b * (2 * sums[PRODUCT, axis] - b * sums[ENERGY, axis]), 0.0)
        error += square[OSCILLATION, axis] / noise[axis, axis]
    numbers[B_SIGMA] = math.sqrt(error / numbers[WEIGHT] / energy)


@compiled
def _best_way(memory: Memory, noise: np.ndarray, since_jump: int
              ) -> tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray,
                         np.ndarray, np.ndarray]:
    """Return the Estimate in the way of the least variance."""
    recent, square, peak, _, numbers = memory
    weight, b, two = numbers[WEIGHT], numbers[B], numbers[FRAMES] > 1
    best, least = STEADY, np.inf
    value, ahead, mean, variance = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    process, unsteady, white = np.zeros(3), np.zeros(3), np.zeros(3)
    room = _room(numbers[FITTED] - 1)
    for way in range(3):
        own2 = chance2 = 0.0
        for k in range(5):
            own = 0.0
            if way == TORQUE or way == OSCILLATION and not two:
                own = DIFFERENCE[k]
            elif way == OSCILLATION:
                own = b * DIFFERENCE[k] - (DIFFERENCE[k - 1] if k else 0.0)
            newest = DIFFERENCE[k + 1] if k < 4 else 0.0
            own2 += own * own
            chance2 += (newest - own) ** 2
        total = 0.0
        for axis in range(3):
            excess = square[way, axis] / weight - chance2 * noise[axis, axis]
            total += (max(excess, 0.0) / noise[axis, axis] + own2 + 2 / weight * chance2)
        if total >= least:
            continue
        best, least = way, total
        for axis in range(3):
            chance, own_variance = chance2 * noise[axis, axis], own2 * noise[axis, axis]
            excess = square[way, axis] / weight - chance
            largest = max(peak[way, axis] ** 2 - 16 * chance, 0.0) / PEAK_SIGMAS ** 2
            variance[axis] = max(max(excess, 0.0) + own_variance + 2 / weight * chance, largest)
            significant = max(excess - SIGNIFICANT * math.sqrt(2 / weight) * chance, 0.0)
            unsteady[axis] = significant * min(
                significant * weight / max(square[STEADY, axis], 1e-300), 1.0)
            left = excess > WHITE_SIGMAS * math.sqrt(2 / weight) * chance
            white[axis] = room * excess / chance2 if left else 0.0
            if (way != OSCILLATION or not LEAST_B < b <= SLOW_B
                    or numbers[FITTED] < WHITE_WEIGHT):
                # Stamps that err to and fro look like an oscillation of two frames in a period.
                white[axis] = np.inf
            last = recent[0, axis]
            value[axis], doubt2 = 0.0 if way == STEADY else last, 0.0
            if way == OSCILLATION and two:
                value[axis] = b * last - recent[1, axis]
                doubt2 = (numbers[B_SIGMA] * last) ** 2
                variance[axis] += doubt2
            ahead[axis] = mean[axis] = value[axis]
            size2 = value[axis] ** 2
            if way == OSCILLATION and two and b > LEAST_B:
                ahead[axis], mean[axis], size2 = _swing(value[axis], last, b)
            process[axis] = significant
            if way != STEADY:
                process[axis] = (max(excess, 0.0) + own_variance + doubt2
                                 + (ENDS * value[axis]) ** 2)
            if size2 <= SURE_SIGMAS ** 2 * variance[axis]:
                # A vibration that the frames hardly show would give the rate of its guess.
                ahead[axis] = mean[axis] = 0.0
                process[axis] += value[axis] ** 2
            if since_jump == 1:
                # The rest of a jump, or a torque that has started.
                variance[axis] += last * last
    return best, value, ahead, mean, variance, process, unsteady, white


@compiled
def _room(freedom: float) -> float:
    """Return the largest variance over the mean of so many squares (Wilson and Hilferty)."""
    if freedom <= 0:
        return np.inf
    variance = 2 / (9 * freedom)
    least = 1 - variance - ROOM_SIGMAS * math.sqrt(variance)
    return least ** -3 if least > 0 else np.inf


@compiled
def _swing(value: float, last: float, b: float) -> tuple[float, float, float]:
    """
    Return the accelerations ahead of an oscillation, and the square of its amplitude.

    value and last are its second differences about this frame and the one before, -(2 - b) / dt^2
    times its angle. Its angle and rate in the next frame follow from those in this one.
    """
    cosine = min(b / 2, SLOWEST)
    angle = math.acos(cosine)
    sine = math.sin(angle)
    onwards = cosine * value - last
    return (value + (angle / sine - 1) / (1 - cosine) * onwards,
            angle / sine * ((1 + cosine) * value + onwards) / 2,
            value ** 2 + (onwards / sine) ** 2)


@compiled
def light_shift(memory: Memory, estimate: Estimate, jump: np.ndarray, dt_s: float, least_s: float,
                most_s: float, rate: np.ndarray, focal_px: float, rows_s2: float,
                known: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Return the Shift for exposures between least_s and most_s.

    jump (3, 3) is the mean square of the turn by a jump.
    """
    b, b_sigma = memory.numbers[B], memory.numbers[B_SIGMA]
    swings = estimate.way == OSCILLATION
    low = _seconds2(least_s, dt_s, b + b_sigma, swings)
    high = _seconds2(most_s, dt_s, b - b_sigma, swings)
    mean, doubt = (low + high) / 2, (high - low) / 2
    if swings and LEAST_B <= b < ALIAS_B:
        mean, doubt = mean / 2, math.hypot(mean / 2, doubt)
    speed2 = rate @ rate
    along = np.zeros(3)
    if speed2 > 0:
        along = rate * ((estimate.value @ rate) / speed2)
    length_px = focal_px * math.hypot(rate[0], rate[1]) * most_s
    long = 1 / (1 + (STREAK_PX / max(length_px, 1e-9)) ** 2)
    seen = estimate.value + long * along
    uncertain = (STREAK_DOUBT * min(length_px / 4, 1.0) + long) * mean
    covariance = (doubt ** 2 * np.outer(seen, seen) + uncertain ** 2 * np.outer(along, along)
                  + most_s / dt_s * jump)
    for axis in range(3):
        covariance[axis, axis] += (((mean + rows_s2) ** 2 + doubt ** 2) * estimate.variance[axis]
                                   + UNSTEADY ** 2 * most_s * dt_s ** 3 * estimate.unsteady[axis])
    if swings and b < LEAST_B:
        # Of so fast an oscillation the frames do not tell the frequency: others look the same.
        covariance += (UNSTEADY * mean) ** 2 * np.outer(seen, seen)
    newest = 0.0 if estimate.way == STEADY else 1.0
    if swings and memory.numbers[FRAMES] > 1:
        newest = b
    return (mean * seen + rows_s2 * (estimate.value - known), covariance,
            newest * (mean + rows_s2) / dt_s ** 2)


@compiled
def _seconds2(exposure_s: float, dt_s: float, b: float, swings: bool) -> float:
    """Return the shift over the acceleration of the differences: T^2 / 24, if it is slow."""
    half = math.asin(math.sqrt(min(max((2 - b) / 4, 0.0), 1.0))) if swings else 0.0  # w dt / 2
    light = half * exposure_s / dt_s  # w T / 2
    if light < 0.01:
        return exposure_s ** 2 / 24
    w = 2 * half / dt_s
    return (light / math.sin(light) - 1) / w ** 2 * (half / math.sin(half)) ** 2


@compiled
def lacking(covariance: np.ndarray, error: np.ndarray, probability: float) -> np.ndarray:
    """
    Return what a covariance (3, 3) lacks for an error (3,) that is possible, zero for nothing.

    With the probability of the error, the attitude is to be beyond WRONG_SIGMAS by it with the
    probability MISSED: within c of WRONG_SIGMAS, as of tail_sigmas(). As much of the square of
    the error is added as makes its Mahalanobis distance WRONG_SIGMAS - c (Sherman and Morrison).
    """
    nothing = np.zeros((3, 3))
    tail = tail_sigmas(probability, MISSED)
    if tail == 0:
        return nothing
    most = max(WRONG_SIGMAS - tail, 1.0)
    distance2 = error @ (inverse(covariance) @ error)
    if distance2 <= most * most:
        return nothing
    return np.outer(error, error) * (1 / (most * most) - 1 / distance2)
