# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitude, rate and gyro bias from all frames of a recording, before and after each.

The filter of attitude_state.py forward and the recursion of Rauch, Tung and Striebel (AIAA J. 3,
1965) backward; Crassidis and Junkins, Optimal Estimation of Dynamic Systems, 5.1. Measurements are
the attitudes of single frames, whose errors are independent, and mean rates of a gyro.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply, turned)

ACCELERATION_FACTORS = (1.0, 10.0, 100.0, 1000.0)
"""Factors of the acceleration noise that are tried until the innovation is within the gate."""

_GATE = gate(1e-5, 3)

_FIRST_RATE_SIGMA_RAD_S = np.radians(10.0)


@dataclass(frozen=True)
class MotionNoise:
    """
    How rate and gyro change between two frames.

    acceleration_density (3,) rad^2/s^3 of a rate that is constant but for white acceleration;
    gyro_density rad^2/s of the white noise of a gyro, drift_density rad^2/s^3 of its bias, and
    drift_sigma_rad_s of that bias at the begin.
    """

    acceleration_density: np.ndarray
    gyro_density: float
    drift_density: float
    drift_sigma_rad_s: float


@dataclass(frozen=True)
class SmoothedAttitude:
    """
    At each frame (N,): quaternion (N, 4), rate_rad_s and bias_rad_s (N, 3), covariance (N, 9, 9).

    The covariance is that of attitude, rate and bias about sensor axes.
    """

    quaternion: np.ndarray
    rate_rad_s: np.ndarray
    bias_rad_s: np.ndarray
    covariance: np.ndarray


def smooth(stamp_ns: np.ndarray, measured: np.ndarray, covariance: np.ndarray,
           noise: MotionNoise, gyro_rad_s: np.ndarray | None = None) -> SmoothedAttitude:
    """
    Return the smoothed attitude of frames (N,), ascending, the first of which is measured.

    measured (N, 4) has NaN where a frame has no attitude; covariance (N, 3, 3) rad^2 is about
    sensor axes. gyro_rad_s (N, 3) is the mean rate since the frame before, NaN where unknown.
    """
    filtered = [_first_state(int(stamp_ns[0]), measured[0], covariance[0], noise)]
    predicted, is_frame = [filtered[0]], [True]
    for k in range(1, len(stamp_ns)):
        rate = gyro_rad_s[k] if gyro_rad_s is not None and np.isfinite(gyro_rad_s[k, 0]) else None
        for level in ACCELERATION_FACTORS:
            steps = _to_frame(filtered[-1], int(stamp_ns[k]), noise, level, rate)
            if _innovation2(steps[-1][0], measured[k], covariance[k]) <= _GATE:
                break
        before, after = steps[-1]
        steps[-1] = before, _with_attitude(after, measured[k], covariance[k])
        predicted += [before for before, _ in steps]
        filtered += [after for _, after in steps]
        is_frame += [False] * (len(steps) - 1) + [True]
    states = [filtered[-1]]
    for k in range(len(filtered) - 2, -1, -1):
        states.append(_backward(filtered[k], predicted[k + 1], states[-1]))
    frames = [state for state, frame in zip(reversed(states), is_frame) if frame]
    return SmoothedAttitude(*(np.array([state[column] for state in frames])
                              for column in (1, 2, 3, 4)))


def _first_state(stamp_ns: int, measured: np.ndarray, covariance: np.ndarray, noise: MotionNoise
                 ) -> AttitudeState:
    P = np.zeros((9, 9))
    P[:3, :3] = covariance
    P[3:6, 3:6] = np.eye(3) * _FIRST_RATE_SIGMA_RAD_S ** 2
    P[6:, 6:] = np.eye(3) * noise.drift_sigma_rad_s ** 2
    return AttitudeState(stamp_ns, np.array(measured, float), np.zeros(3), np.zeros(3), P)


def _to_frame(state: AttitudeState, stamp_ns: int, noise: MotionNoise, level: float,
              gyro_rad_s: np.ndarray | None) -> list[tuple[AttitudeState, AttitudeState]]:
    """
    Return the states before and after the updates on the way to a frame, that of the frame last.

    A mean rate counts at the middle of its interval.
    """
    density, steps = level ** 2 * noise.acceleration_density, []
    if gyro_rad_s is not None:
        interval_s = (stamp_ns - state.stamp_ns) * 1e-9
        before = state.propagated_at_constant_rate(
            (state.stamp_ns + stamp_ns) // 2, density, noise.drift_density)
        state = before.with_rate(gyro_rad_s, noise.gyro_density / interval_s)
        steps.append((before, state))
    before = state.propagated_at_constant_rate(stamp_ns, density, noise.drift_density)
    return [*steps, (before, before)]


def _innovation2(state: AttitudeState, measured: np.ndarray, covariance: np.ndarray) -> float:
    """Return the normalised innovation squared of an attitude, 0 without one."""
    if not np.isfinite(measured[0]):
        return 0.0
    error = attitude_error(measured, state.quaternion)
    return float(error @ np.linalg.solve(state.covariance[:3, :3] + covariance, error))


def _with_attitude(state: AttitudeState, measured: np.ndarray, covariance: np.ndarray
                   ) -> AttitudeState:
    """Return the state updated by the attitude of a frame, if it has one."""
    if not np.isfinite(measured[0]):
        return state
    information = np.linalg.inv(covariance)
    return state.with_attitude(
        information, information @ attitude_error(measured, state.quaternion))


def _backward(state: AttitudeState, predicted: AttitudeState, after: AttitudeState
              ) -> AttitudeState:
    """C = P Phi^T (P-)^-1; x + C (x_s - x-), P + C (P_s - P-) C^T."""
    turn = multiply(conjugate(state.quaternion), predicted.quaternion)
    Phi = np.eye(9)
    Phi[:3, :3] = matrix_from_quaternion(turn).T
    Phi[:3, 3:6] = np.eye(3) * ((predicted.stamp_ns - state.stamp_ns) * 1e-9)
    C = np.linalg.solve(predicted.covariance, Phi @ state.covariance).T
    change = C @ np.concatenate([
        attitude_error(after.quaternion, predicted.quaternion), after.rate - predicted.rate,
        after.drift - predicted.drift])
    P = state.covariance + C @ (after.covariance - predicted.covariance) @ C.T
    return AttitudeState(state.stamp_ns, turned(state.quaternion, change[:3]),
                         state.rate + change[3:6], state.drift + change[6:], (P + P.T) / 2)
