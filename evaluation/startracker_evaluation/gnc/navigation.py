# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude and rate between the measurements of a star tracker, for a controller."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, multiply, quaternion_from_rotation_vector)

GATE = gate(1.4e-6, 3)
"""Bound of the normalised innovation squared."""


@dataclass(frozen=True)
class NavigationOptions:
    """
    Errors of the model, the measurements, and how long an attitude is propagated.

    acceleration_rad_s2 is the white noise of the angular acceleration in rad/s^2 * sqrt(s),
    disturbance_rad_s3 that of its unknown part; torque_error is the part of the known torques
    that acts as noise, for an inertia that is not known better. The errors of a tracker that
    filters are correlated from frame to frame: inflation multiplies its variances. time_sigma_s
    is the error of the time tags; the rate times it is added to the error of the attitude: the
    rate of the state, as that of a tracker follows the error of the tags. A
    propagated attitude ends with sigma_max_rad on any axis or after hold_max_s. After
    rejected_max measurements in a row that do not fit, the filter restarts with the next.
    """

    acceleration_rad_s2: float = 2e-6
    disturbance_rad_s3: float = 1e-7
    torque_error: float = 0.01
    inflation: float = 4.0
    sigma_floor_rad: float = 0.3 * ARCSEC
    time_sigma_s: float = 0.02
    sigma_max_rad: float = float(np.radians(0.5))
    hold_max_s: float = 120.0
    rejected_max: int = 5


@dataclass(frozen=True)
class NavigationState:
    """
    Attitude and rate of one instant.

    q_icrf_from_body (4,), rate_rad_s (3,) on body axes; covariance (9, 9) of the rotation vector
    of attitude_error, the rate and the angular acceleration by unknown torques.
    """

    time_ns: int
    q_icrf_from_body: np.ndarray
    rate_rad_s: np.ndarray
    disturbance_rad_s2: np.ndarray
    covariance: np.ndarray


class Navigation:
    """
    A multiplicative extended Kalman filter with the dynamics of the body.

    Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, 6.2,
    with Euler's equation in place of a gyro: J w' = torque - w x (J w + h) + J d. A measurement
    that is not trusted is not used: the attitude is propagated. state is None before the first
    measurement, and when the propagation has ended.

    rejected counts the measurements that the gate rejected, restarts its restarts.
    """

    def __init__(self, inertia_kg_m2: np.ndarray,
                 options: NavigationOptions = NavigationOptions()) -> None:
        self._inertia = np.asarray(inertia_kg_m2, float)
        self._options = options
        self.state: NavigationState | None = None
        self.rejected = self.restarts = 0
        self._rejected_in_row = 0
        self._measured_ns: int | None = None

    def hold_s(self, time_ns: int) -> float:
        """Return the time in s since the measurement that was used last, 0 without any."""
        return 0.0 if self._measured_ns is None else (time_ns - self._measured_ns) * 1e-9

    def propagate(self, time_ns: int, torque_n_m: np.ndarray, momentum_n_m_s: np.ndarray) -> None:
        """Propagate by the torque (3,) on the body, and the momentum (3,) of its wheels."""
        if self.state is None:
            return
        state = self.predicted(time_ns, torque_n_m, momentum_n_m_s)
        sigma_rad = np.sqrt(state.covariance.diagonal()[:3].max())
        kept = (sigma_rad <= self._options.sigma_max_rad
                and self.hold_s(time_ns) <= self._options.hold_max_s)
        self.state = state if kept else None

    def predicted(self, time_ns: int, torque_n_m: np.ndarray, momentum_n_m_s: np.ndarray
                  ) -> NavigationState:
        """Return the state propagated to a time; it must exist."""
        state, options = self.state, self._options
        assert state is not None
        dt_s = (time_ns - state.time_ns) * 1e-9
        before = state.rate_rad_s
        middle = before + self._acceleration(state, before, torque_n_m, momentum_n_m_s) * dt_s / 2
        acceleration = self._acceleration(state, middle, torque_n_m, momentum_n_m_s)
        rate = before + acceleration * dt_s
        turn = quaternion_from_rotation_vector(middle * dt_s)
        transition = np.eye(9)
        transition[:3, :3] = matrix_from_quaternion(turn).T
        transition[:3, 3:6] = transition[3:6, 6:] = dt_s * np.eye(3)
        transition[:3, 6:] = dt_s ** 2 / 2 * np.eye(3)
        covariance = transition @ state.covariance @ transition.T
        covariance[range(3, 6), range(3, 6)] += dt_s * (
            options.acceleration_rad_s2 ** 2 + np.square(options.torque_error * acceleration))
        covariance[range(6, 9), range(6, 9)] += options.disturbance_rad_s3 ** 2 * dt_s
        return NavigationState(time_ns, _normalised(multiply(state.q_icrf_from_body, turn)), rate,
                               state.disturbance_rad_s2, covariance)

    def correct(self, time_ns: int, quaternion: np.ndarray, covariance: np.ndarray,
                rate_rad_s: np.ndarray) -> np.ndarray | None:
        """
        Use a trusted attitude q_icrf_from_body (4,) of the time of the state.

        covariance (3, 3) rad^2 is that of attitude_error on body axes; rate_rad_s (3,) begins
        the filter. Returns the covariance (3, 3) that it was used with, its time included; None
        if it is too far from the prediction.
        """
        state = self.state
        if state is None or self._rejected_in_row >= self._options.rejected_max:
            self.restarts += state is not None
            covariance = self._with_time_error(covariance, rate_rad_s)
            self._begin(time_ns, quaternion, covariance, rate_rad_s)
            return covariance
        covariance = self._with_time_error(covariance, state.rate_rad_s)
        innovation = attitude_error(quaternion, state.q_icrf_from_body)
        total = state.covariance[:3, :3] + covariance
        if innovation @ np.linalg.solve(total, innovation) > GATE:
            self.rejected += 1
            self._rejected_in_row += 1
            return None
        gain = np.linalg.solve(total, state.covariance[:3]).T
        change = gain @ innovation
        left = np.eye(9)
        left[:, :3] -= gain
        # Joseph's form keeps the covariance positive.
        updated = left @ state.covariance @ left.T + gain @ covariance @ gain.T
        turn = quaternion_from_rotation_vector(change[:3])
        self.state = NavigationState(
            time_ns, _normalised(multiply(state.q_icrf_from_body, turn)),
            state.rate_rad_s + change[3:6], state.disturbance_rad_s2 + change[6:], updated)
        self._rejected_in_row, self._measured_ns = 0, time_ns
        return covariance

    def _with_time_error(self, covariance: np.ndarray, rate_rad_s: np.ndarray) -> np.ndarray:
        options = self._options
        return (options.inflation * covariance + options.sigma_floor_rad ** 2 * np.eye(3)
                + np.outer(rate_rad_s, rate_rad_s) * options.time_sigma_s ** 2)

    def _begin(self, time_ns: int, quaternion: np.ndarray, covariance: np.ndarray,
               rate_rad_s: np.ndarray) -> None:
        initial = np.diag(np.repeat([0.0, np.radians(0.05) ** 2, 2e-5 ** 2], 3))
        initial[:3, :3] = covariance
        self.state = NavigationState(time_ns, quaternion, rate_rad_s, np.zeros(3), initial)
        self._rejected_in_row, self._measured_ns = 0, time_ns

    def _acceleration(self, state: NavigationState, rate: np.ndarray, torque_n_m: np.ndarray,
                      momentum_n_m_s: np.ndarray) -> np.ndarray:
        gyroscopic = np.cross(rate, self._inertia * rate + momentum_n_m_s)
        return (torque_n_m - gyroscopic) / self._inertia + state.disturbance_rad_s2


def _normalised(q: np.ndarray) -> np.ndarray:
    return q / np.linalg.norm(q)
