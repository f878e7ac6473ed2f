# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A motion given by samples, as a dynamics simulator publishes it."""

from collections import deque

import numpy as np
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotation_vector_from_quaternion)
from startracker_ros.sim.sky.motion_state import MotionState

KEPT_S = 3.0
"""Samples that are older than the newest by more are forgotten: a torn image needs the motion of
the frame before, the gyro that of the time between two frames."""

MAX_TURN_RAD = np.radians(90.0)
"""Largest turn between two samples; the attitude between them is unknown after a larger one."""


class SampleError(ValueError):
    """A sample that is not newer than the one before."""


class SampledMotion:
    """
    Attitude, rate, position and velocity between samples, and beyond the newest.

    Between two samples the rotation vector from the older one is the cubic polynomial with the
    attitudes and the rates of both, and so is the position with the velocities. Beyond the
    newest the rate and the velocity are constant: with an acceleration a the attitude is then
    a t^2 / 2 off after the time t.
    """

    def __init__(self) -> None:
        self._samples: deque[tuple[float, MotionState]] = deque()

    @property
    def newest_s(self) -> float:
        """Return the time of the newest sample in s, -inf without any."""
        return self._samples[-1][0] if self._samples else -np.inf

    def add(self, time_s: float, state: MotionState) -> float:
        """
        Add a sample newer than all before; return how much attitudes and rates disagree.

        That is the angle in rad between the attitude of the sample and the one that the mean of
        the rates of this sample and the one before gives. After a turn by more than MAX_TURN_RAD
        it is infinite, and the motion restarts with the sample. SampleError, without a change,
        for a sample that is not newer.
        """
        if time_s <= self.newest_s:
            raise SampleError(f'{self.newest_s - time_s:g} s older than the newest')
        disagreement_rad = 0.0
        if self._samples:
            before_s, before = self._samples[-1]
            turn = _turn(before, state)
            expected = (before.rate_rad_s + state.rate_rad_s) / 2 * (time_s - before_s)
            disagreement_rad = float(np.linalg.norm(turn - expected))
            if max(np.linalg.norm(turn), np.linalg.norm(expected)) > MAX_TURN_RAD:
                self._samples.clear()
                disagreement_rad = np.inf
        self._samples.append((time_s, state))
        while time_s - self._samples[0][0] > KEPT_S and len(self._samples) > 2:
            self._samples.popleft()
        return disagreement_rad

    def at(self, time_s: float) -> MotionState:
        """Return the state; IndexError without a sample."""
        samples = self._samples
        if time_s >= samples[-1][0] or len(samples) == 1:
            return _extrapolated(*samples[-1], time_s)
        if time_s <= samples[0][0]:
            return _extrapolated(*samples[0], time_s)
        index = next(i for i in range(len(samples) - 1, 0, -1) if samples[i - 1][0] <= time_s)
        return _interpolated(*samples[index - 1], *samples[index], time_s)


def _turn(before: MotionState, after: MotionState) -> np.ndarray:
    return rotation_vector_from_quaternion(
        multiply(conjugate(before.q_icrf_from_sensor), after.q_icrf_from_sensor))


def _extrapolated(sample_s: float, state: MotionState, time_s: float) -> MotionState:
    dt_s = time_s - sample_s
    turn = quaternion_from_rotation_vector(state.rate_rad_s * dt_s)
    return MotionState(multiply(state.q_icrf_from_sensor, turn), state.rate_rad_s,
                       state.position_m + state.velocity_m_s * dt_s, state.velocity_m_s)


def _interpolated(a_s: float, a: MotionState, b_s: float, b: MotionState, time_s: float
                  ) -> MotionState:
    length_s = b_s - a_s
    s = (time_s - a_s) / length_s
    turn = _turn(a, b)
    # The derivative of a rotation vector r is w + r x w / 2 + r x (r x w) / 12 + O(r^4).
    across = np.cross(turn, b.rate_rad_s)
    rate_b = b.rate_rad_s + across / 2 + np.cross(turn, across) / 12
    r, r_dot = _hermite(s, length_s, np.zeros(3), a.rate_rad_s, turn, rate_b)
    across = np.cross(r, r_dot)
    rate_rad_s = r_dot - across / 2 + np.cross(r, across) / 6
    position_m, velocity_m_s = _hermite(
        s, length_s, a.position_m, a.velocity_m_s, b.position_m, b.velocity_m_s)
    return MotionState(multiply(a.q_icrf_from_sensor, quaternion_from_rotation_vector(r)),
                       rate_rad_s, position_m, velocity_m_s)


def _hermite(s: float, length_s: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray,
             v1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return value and derivative at s in 0 .. 1 of the cubic through x0, v0 and x1, v1."""
    rise = x1 - x0
    b = 3 * rise - length_s * (2 * v0 + v1)
    c = -2 * rise + length_s * (v0 + v1)
    return (x0 + s * (length_s * v0 + s * (b + s * c)),
            v0 + s * (2 * b + 3 * s * c) / length_s)
