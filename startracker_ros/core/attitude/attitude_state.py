# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitude, body rate and gyro drift with their covariance, propagated and updated: compiled.

The multiplicative Kalman filter of Lefferts, Markley and Shuster (J. Guid. Control 5,
1982). Its error state about sensor axes is [attitude rad, rate rad/s, drift rad/s], (9,).
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_rotation_vector, turned
from startracker_ros.core.maths.small_algebra import inverse


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
        drift about all axes, are spectral densities in rad^2/s^3.
        """
        return AttitudeState(to_ns, *_propagated_at_constant_rate(
            *self[1:], (to_ns - self.stamp_ns) * 1e-9, acceleration_density, drift_density))

    def propagated_at_gyro_rates(self, to_ns: int, dt_s: np.ndarray, measured: np.ndarray,
                                 noise_density: np.ndarray, attitude_variance: np.ndarray,
                                 drift_density: float) -> 'AttitudeState':
        """
        Return the state at a later time; the rates are measured (K, 3) rad/s minus the drift.

        They last for dt_s (K,) one after another. The rate of the state before is not used.
        noise_density (K,) is that of the white noise of the gyro, rad^2/s; attitude_variance (K,)
        rad^2 is added to each axis.
        """
        return AttitudeState(to_ns, *_propagated_at_gyro_rates(
            *self[1:], dt_s, measured, noise_density, attitude_variance, drift_density))

    def with_rate(self, measured: np.ndarray, variance: float) -> 'AttitudeState':
        """Return the state updated by a measured rate (3,) of this variance of each axis."""
        return AttitudeState(self.stamp_ns, *_with_rate(*self[1:], measured, variance))

    def with_attitude(self, information: np.ndarray, vector: np.ndarray) -> 'AttitudeState':
        """
        Return the state updated by a measured error of attitude, in information form.

        information (3, 3) is the inverse covariance of the measurement, which may be
        singular; vector (3,) is information times the measured rotation vector. With (6, 6) and
        (6,) the rate is measured as well.
        """
        return AttitudeState(self.stamp_ns, *with_attitude(*self[1:], information, vector))

    def with_new_drift(self, sigma_rad_s: float) -> 'AttitudeState':
        """Return the state with a drift of zero, of this 1-sigma error and uncorrelated."""
        covariance = self.covariance.copy()
        covariance[6:], covariance[:, 6:] = 0.0, 0.0
        covariance[6:, 6:] = np.eye(3) * sigma_rad_s ** 2
        return self._replace(drift=np.zeros(3), covariance=covariance)


@compiled
def _turn_transition(turn: np.ndarray) -> np.ndarray:
    """Return the identity (9, 9) with exp(-[turn]x), the attitude error on turned axes."""
    transition = np.eye(9)
    transition[:3, :3] = matrix_from_rotation_vector(turn).T
    return transition


@compiled
def _propagated_at_constant_rate(
        quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray, covariance: np.ndarray,
        dt_s: float, acceleration_density: np.ndarray, drift_density: float
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """P <- Phi P Phi^T + Q with attitude error' = rate error: Phi[attitude, rate] = dt I."""
    turn = rate * dt_s
    transition = _turn_transition(turn)
    process = np.zeros((9, 9))
    for axis in range(3):
        transition[axis, 3 + axis] = dt_s
        process[axis, axis] = acceleration_density[axis] * dt_s ** 3 / 3
        process[axis, 3 + axis] = acceleration_density[axis] * dt_s ** 2 / 2
        process[3 + axis, axis] = acceleration_density[axis] * dt_s ** 2 / 2
        process[3 + axis, 3 + axis] = acceleration_density[axis] * dt_s
        process[6 + axis, 6 + axis] = drift_density * dt_s
    return turned(quaternion, turn), rate, drift, transition @ covariance @ transition.T + process


@compiled
def _propagated_at_gyro_rates(
        quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray, covariance: np.ndarray,
        dt_s: np.ndarray, measured: np.ndarray, noise_density: np.ndarray,
        attitude_variance: np.ndarray, drift_density: float
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """P <- Phi P Phi^T + Q with rate error = -drift error: Phi[attitude, drift] = -dt I."""
    for k in range(len(dt_s)):
        rate = measured[k] - drift
        turn = rate * dt_s[k]
        transition = _turn_transition(turn)
        for axis in range(3):
            transition[axis, 6 + axis] = -dt_s[k]
            transition[3 + axis, 3 + axis] = 0.0
            transition[3 + axis, 6 + axis] = -1.0
        quaternion, covariance = turned(quaternion, turn), transition @ covariance @ transition.T
        for axis in range(3):
            covariance[axis, axis] += noise_density[k] * dt_s[k] + attitude_variance[k]
            covariance[axis, 3 + axis] += noise_density[k]
            covariance[3 + axis, axis] += noise_density[k]
            covariance[3 + axis, 3 + axis] += noise_density[k] / dt_s[k]
            covariance[6 + axis, 6 + axis] += drift_density * dt_s[k]
    return quaternion, rate, drift, covariance


@compiled
def _with_rate(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray, covariance: np.ndarray,
               measured: np.ndarray, variance: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """K = P H^T S^-1 with H = [0 I I] and S = H P H^T + R; x <- x + K z, P <- P - K H P."""
    cross_covariance = covariance[:, 3:6] + covariance[:, 6:]
    innovation_covariance = cross_covariance[3:6] + cross_covariance[6:] + variance * np.eye(3)
    gain = cross_covariance @ inverse(innovation_covariance)
    change = gain @ (measured - rate - drift)
    after = covariance - gain @ cross_covariance.T
    return (turned(quaternion, change[:3]), rate + change[3:6], drift + change[6:],
            (after + after.T) / 2)


@compiled
def with_attitude(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray,
                  covariance: np.ndarray, information: np.ndarray, vector: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return quaternion, rate, drift and covariance as the method of AttitudeState has them.

    With H = [I 0], Y the information and y the vector:
    P <- P - P H^T (I + Y H P H^T)^-1 Y H P, x <- x + P H^T y.
    """
    count = len(vector)
    measured = np.ascontiguousarray(covariance[:count, :count])
    rows = np.ascontiguousarray(covariance[:count])
    columns = np.ascontiguousarray(covariance[:, :count])
    gain = np.linalg.solve(np.eye(count) + information @ measured, information)
    after = covariance - columns @ gain @ rows
    # Rounding makes it unsymmetric, and what is unsymmetric would grow from frame to frame.
    after = (after + after.T) / 2
    change = np.ascontiguousarray(after[:, :count]) @ vector
    return turned(quaternion, change[:3]), rate + change[3:6], drift + change[6:], after
