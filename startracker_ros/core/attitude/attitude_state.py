# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitude, body rate and gyro drift with their covariance, propagated and updated.

The multiplicative Kalman filter of Lefferts, Markley and Shuster (J. Guid. Control 5,
1982). Its error state about sensor axes is [attitude rad, rate rad/s, drift rad/s], (9,).
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, quaternion_from_rotation_vector, turned)

_ANGLE, _RATE, _DRIFT = np.arange(9).reshape(3, 3)


class AttitudeState(NamedTuple):
    """
    The state of the filter at a time.

    quaternion (4,) is q_icrf_from_sensor; rate and drift (3,) rad/s are on sensor axes, a
    gyro measures their sum; covariance (9, 9) is that of the error state.
    """

    stamp_ns: int
    quaternion: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    covariance: np.ndarray

    def propagated_at_constant_rate(self, to_ns: int, acceleration_density: np.ndarray,
                                    drift_density: float) -> 'AttitudeState':
        """
        Return the state at a later time; the rate is constant but for white acceleration.

        acceleration_density (3,) about each axis and drift_density, that of the change of the
        drift about all axes, are spectral densities in rad^2/s^3. P <- Phi P Phi^T + Q with
        attitude error' = rate error: Phi[attitude, rate] = dt I.
        """
        dt_s = (to_ns - self.stamp_ns) * 1e-9
        turn = self.rate * dt_s
        Phi = _turn_transition(turn)
        Phi[:3, 3:6] = dt_s * np.eye(3)
        P = Phi @ self.covariance @ Phi.T
        P[_ANGLE, _ANGLE] += acceleration_density * dt_s ** 3 / 3
        P[_ANGLE, _RATE] += acceleration_density * dt_s ** 2 / 2
        P[_RATE, _ANGLE] += acceleration_density * dt_s ** 2 / 2
        P[_RATE, _RATE] += acceleration_density * dt_s
        P[_DRIFT, _DRIFT] += drift_density * dt_s
        return AttitudeState(to_ns, turned(self.quaternion, turn), self.rate, self.drift, P)

    def propagated_at_gyro_rates(self, to_ns: int, dt_s: np.ndarray, measured: np.ndarray,
                                 noise_density: np.ndarray, attitude_variance: np.ndarray,
                                 drift_density: float) -> 'AttitudeState':
        """
        Return the state at a later time; the rates are measured (K, 3) rad/s minus the drift.

        They last for dt_s (K,) one after another. The rate of the state before is not used.
        noise_density (K,) is that of the white noise of the gyro, rad^2/s; attitude_variance (K,)
        rad^2 is added to each axis. P <- Phi P Phi^T + Q with rate error = -drift error:
        Phi[attitude, drift] = -dt I.
        """
        _, quaternion, rate, drift, P = self
        for dt, gyro, noise, variance in zip(dt_s, measured, noise_density, attitude_variance):
            rate = gyro - drift
            turn = rate * dt
            Phi = _turn_transition(turn)
            Phi[:3, 6:] = -dt * np.eye(3)
            Phi[3:6, 3:6], Phi[3:6, 6:] = 0.0, -np.eye(3)
            quaternion, P = turned(quaternion, turn), Phi @ P @ Phi.T
            P[_ANGLE, _ANGLE] += noise * dt + variance
            P[_ANGLE, _RATE] += noise
            P[_RATE, _ANGLE] += noise
            P[_RATE, _RATE] += noise / dt
            P[_DRIFT, _DRIFT] += drift_density * dt
        return AttitudeState(to_ns, quaternion, rate, drift, P)

    def with_rate(self, measured: np.ndarray, variance: float) -> 'AttitudeState':
        """
        Return the state updated by a measured rate (3,) of this variance of each axis.

        K = P H^T S^-1 with H = [0 I I] and S = H P H^T + R; x <- x + K z, P <- P - K H P.
        """
        PH = self.covariance[:, 3:6] + self.covariance[:, 6:]
        S = PH[3:6] + PH[6:] + variance * np.eye(3)
        K = np.linalg.solve(S, PH.T).T
        return self._changed(K @ (measured - self.rate - self.drift),
                             self.covariance - K @ PH.T)

    def with_attitude(self, information: np.ndarray, vector: np.ndarray) -> 'AttitudeState':
        """
        Return the state updated by a measured error of attitude, in information form.

        information (3, 3) is the inverse covariance of the measurement, which may be
        singular; vector (3,) is information times the measured rotation vector. With H = [I 0],
        Y the information and y the vector:
        P <- P - P H^T (I + Y H P H^T)^-1 Y H P, x <- x + P H^T y.
        """
        P = self.covariance
        gain = np.linalg.solve(np.eye(3) + information @ P[:3, :3], information)
        after = P - P[:, :3] @ gain @ P[:3]
        return self._changed((after[:, :3] + after[:3].T) / 2 @ vector, after)

    def _changed(self, change: np.ndarray, covariance: np.ndarray) -> 'AttitudeState':
        """Return the state with an error state (9,) corrected, of this covariance."""
        # Rounding makes it unsymmetric, and what is unsymmetric would grow from frame to frame.
        return AttitudeState(
            self.stamp_ns, turned(self.quaternion, change[:3]), self.rate + change[3:6],
            self.drift + change[6:], (covariance + covariance.T) / 2)

    def with_new_drift(self, sigma_rad_s: float) -> 'AttitudeState':
        """Return the state with a drift of zero, of this 1-sigma error and uncorrelated."""
        covariance = self.covariance.copy()
        covariance[6:], covariance[:, 6:] = 0.0, 0.0
        covariance[6:, 6:] = np.eye(3) * sigma_rad_s ** 2
        return self._replace(drift=np.zeros(3), covariance=covariance)


def _turn_transition(turn: np.ndarray) -> np.ndarray:
    """Return the identity (9, 9) with exp(-[turn]x), the attitude error on turned axes."""
    transition = np.eye(9)
    transition[:3, :3] = matrix_from_quaternion(quaternion_from_rotation_vector(turn)).T
    return transition
