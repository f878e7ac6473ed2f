# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured body rates with their error model, and the propagation of an attitude by them."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.options import option, Options
from startracker_ros.core.values import vector_of

_DEG_H = np.radians(1 / 3600)
_DEG_SQRT_H = np.radians(1 / 60)
_HOUR_S = 3600.0

MAX_RATE_RAD_S = np.radians(100.0)
"""Faster than any spacecraft that sees stars turns: such a measurement is rejected."""

IMPOSSIBLE_RAD_S = 100.0
"""More than the range of any gyro, 5730 deg/s: such a number is in another unit."""

SATURATED = 0.999  # of the range
_MAX_MEASUREMENTS = 100_000


@dataclass(frozen=True)
class GyroErrorOptions(Options):
    """Errors of the measured rates; too small figures lose the stars after a pause."""

    gyro_drift_deg_h: float = option(
        3.0, 'constant drift of the gyro, 1 sigma of each axis; it is estimated, and may change '
        'by as much in an hour', unit='deg/h', low=0.001, high=10000.0)
    gyro_noise_deg_sqrt_h: float = option(
        0.15, 'white noise of the gyro (angle random walk), each axis', unit='deg/sqrt(h)',
        low=0.0, high=100.0)
    gyro_range_deg_s: float = option(
        100.0, 'largest rate that the gyro measures; a rate that reaches it on an axis is '
        'saturated: the true one is larger by an unknown amount', unit='deg/s', low=0.1,
        high=100.0)
    gyro_rate_change_deg_s2: float = option(
        0.1, 'how fast the body may change its rate between measurements, 1 sigma of each axis: '
        'what a gap in imu costs', unit='deg/s^2', low=0.0, high=1000.0)


class GyroStep(NamedTuple):
    """
    A measured rate (3,) rad/s that holds for dt_s until a time.

    noise_density rad^2/s is that of its white noise, larger where a short mean is used for long;
    variance rad^2 is that of the turn about each axis, of a rate measured at another time.
    """

    until_ns: int
    dt_s: float
    rate_rad_s: np.ndarray
    noise_density: float
    variance: float


def checked_rate(rate_rad_s: np.ndarray) -> np.ndarray:
    """
    Return a rate (3,) in rad/s about sensor axes as float64.

    ValueError for another shape, NaN, infinity, and for what no gyro measures.
    """
    rate = vector_of('rate_rad_s', rate_rad_s)
    if np.abs(rate).max() > IMPOSSIBLE_RAD_S:
        raise ValueError(f'rate_rad_s = {rate.tolist()} is {np.degrees(np.abs(rate).max()):.0f} '
                         'deg/s, more than any gyro measures: it must be in rad/s')
    return rate


class Gyro:
    """
    The latest rates, which propagate an attitude.

    The errors are those of Farrenkopf's model (J. Guid. Control 1, 1978). A measured rate
    is the mean over the interval since the previous measurement and is used over that
    interval. Where there is none the nearest one is used, and the uncertainty grows with the
    distance in time.
    """

    def __init__(self, options: GyroErrorOptions = GyroErrorOptions()) -> None:
        self.drift_sigma_rad_s = options.gyro_drift_deg_h * _DEG_H
        self.drift_density = self.drift_sigma_rad_s ** 2 / _HOUR_S
        self.noise_density = (options.gyro_noise_deg_sqrt_h * _DEG_SQRT_H) ** 2
        self._rate_change_rad_s2 = np.radians(options.gyro_rate_change_deg_s2)
        self._range_rad_s = SATURATED * np.radians(options.gyro_range_deg_s)
        self._stamps_ns: list[int] = []
        self._rates: list[np.ndarray] = []

    def add(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """
        Add the rate (3,) about sensor axes measured up to a time; False if it is rejected.

        Measurements come in the order of their stamps. One that reaches the range is rejected.
        """
        rate = np.array(rate_rad_s, float)
        x, y, z = map(abs, rate.tolist())
        # Written so that NaN is rejected.
        if not x + y + z < math.inf or max(x, y, z) >= self._range_rad_s:
            return False
        if len(self._rates) >= _MAX_MEASUREMENTS:
            half = _MAX_MEASUREMENTS // 2
            del self._stamps_ns[:half], self._rates[:half]
        self._stamps_ns.append(stamp_ns)
        self._rates.append(rate)
        return True

    def __len__(self) -> int:
        return len(self._rates)

    def propagate(self, state: AttitudeState, to_ns: int) -> AttitudeState:
        """Return the state at a later time, propagated by the measured rates alone."""
        steps = list(self.steps(state.stamp_ns, to_ns))
        if not steps:
            return state
        _, dt_s, rates, noise_density, variance = map(np.array, zip(*steps))
        return state.propagated_at_gyro_rates(
            to_ns, dt_s, rates, noise_density, variance, self.drift_density)

    def predict(self, state: AttitudeState, to_ns: int) -> tuple[AttitudeState, AttitudeState]:
        """
        Return the state at the newest rate and at a later time, both by the rates alone.

        The next prediction begins at the first: rates that come late are used then.
        """
        state = self.propagate(state, min(self._stamps_ns[-1], to_ns))
        return state, self.propagate(state, to_ns)

    def steps(self, from_ns: int, to_ns: int) -> Iterator[GyroStep]:
        """Yield the measured rates that propagate an attitude from one time to another."""
        index = bisect_right(self._stamps_ns, from_ns)
        while from_ns < to_ns:
            used = min(index, len(self._rates) - 1)
            measured_ns = self._stamps_ns[used]
            until_ns = to_ns if used < index else min(measured_ns, to_ns)
            dt_s = (until_ns - from_ns) * 1e-9
            away_s = max(abs(measured_ns - from_ns), abs(measured_ns - until_ns)) * 1e-9
            yield GyroStep(until_ns, dt_s, self._rates[used],
                           self.noise_density * max(1.0, dt_s / self._mean_s(used)),
                           (self._rate_change_rad_s2 * away_s * dt_s) ** 2)
            from_ns = until_ns
            index += 1

    def _mean_s(self, index: int) -> float:
        """Return the time that a rate is the mean of, infinity where nothing shows it."""
        stamps_ns = self._stamps_ns
        before = bisect_left(stamps_ns, stamps_ns[index]) - 1
        if before >= 0:
            return (stamps_ns[index] - stamps_ns[before]) * 1e-9
        after = bisect_right(stamps_ns, stamps_ns[index])
        return ((stamps_ns[after] - stamps_ns[index]) * 1e-9 if after < len(stamps_ns)
                else math.inf)
