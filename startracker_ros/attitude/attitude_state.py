"""
Attitude, body rate and gyro drift, carried on and corrected: compiled.

The multiplicative Kalman filter of Lefferts, Markley and Shuster (J. Guid. Control 5,
1982). Its error state about sensor axes is [attitude rad, rate rad/s, drift rad/s], (9,).
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.compiled import compiled


class AttitudeState(NamedTuple):
    """
    Where the body stands, how fast it turns, what its gyro drifts by, and how sure all is.

    quaternion (4,) is q_icrf_from_sensor; rate and drift (3,) rad/s are on sensor axes, a
    gyro measures their sum; covariance (9, 9) is that of attitude, rate and drift.
    """

    stamp_ns: int
    quaternion: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    covariance: np.ndarray

    def by_inertia(self, to_ns: int, acceleration_density: np.ndarray,
                   drift_density: float) -> 'AttitudeState':
        """
        Return the state at a later time if the rate goes on.

        But for white accelerations and changes of the drift of these densities, rad^2/s^3:
        acceleration_density (3,) about each axis, drift_density about all.
        """
        return AttitudeState(to_ns, *_by_inertia(
            *self[1:], (to_ns - self.stamp_ns) * 1e-9, acceleration_density, drift_density))

    def by_rate(self, to_ns: int, measured: np.ndarray, noise_density: float,
                attitude_variance: float, drift_density: float) -> 'AttitudeState':
        """
        Return the state at a later time after the turn that a gyro measured (3,) rad/s.

        Whatever the rate was before. White noise of the gyro of this density, rad^2/s;
        attitude_variance rad^2 is added to each axis.
        """
        return AttitudeState(to_ns, *_by_rate(
            *self[1:], measured, (to_ns - self.stamp_ns) * 1e-9, noise_density,
            attitude_variance, drift_density))

    def with_rate(self, measured: np.ndarray, variance: float) -> 'AttitudeState':
        """Return the state after a measured rate (3,) of this variance of each axis."""
        return AttitudeState(self.stamp_ns, *_with_rate(*self[1:], measured, variance))

    def with_attitude(self, information: np.ndarray, vector: np.ndarray) -> 'AttitudeState':
        """
        Return the state after a measurement of its attitude error, in information form.

        information (3, 3) is the inverse covariance of the measurement, which may be
        singular; vector (3,) is information times the turn that the measurement asks for.
        """
        return AttitudeState(self.stamp_ns, *with_attitude(*self[1:], information, vector))

    def less_sure(self, factor: float) -> 'AttitudeState':
        """Return the state with so many times the variance of attitude and rate."""
        scale = np.repeat([np.sqrt(factor), np.sqrt(factor), 1.0], 3)
        return self._replace(covariance=self.covariance * np.outer(scale, scale))

    def with_new_drift(self, sigma_rad_s: float) -> 'AttitudeState':
        """Return the state with nothing known of the drift but its size."""
        covariance = self.covariance.copy()
        covariance[6:], covariance[:, 6:] = 0.0, 0.0
        covariance[6:, 6:] = np.eye(3) * sigma_rad_s ** 2
        return self._replace(drift=np.zeros(3), covariance=covariance)


@compiled
def turned(quaternion: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return a quaternion (4,) after a turn by a rotation vector (3,) about sensor axes."""
    angle = np.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    scale = np.sin(angle / 2) / angle if angle > 1e-8 else 0.5
    bx, by, bz = scale * rotation[0], scale * rotation[1], scale * rotation[2]
    bw = np.cos(angle / 2)
    ax, ay, az, aw = quaternion
    q = np.array([aw * bx + ax * bw + ay * bz - az * by,
                  aw * by - ax * bz + ay * bw + az * bx,
                  aw * bz + ax * by - ay * bx + az * bw,
                  aw * bw - ax * bx - ay * by - az * bz])
    return q / np.sqrt(np.sum(q * q))


@compiled
def _turn_transition(turn: np.ndarray) -> np.ndarray:
    """
    Return the identity (9, 9) with the attitude error seen from turned axes.

    exp(-[turn]x) to third order: turn (3,) is a small part of a rad.
    """
    transition = np.eye(9)
    x, y, z = turn
    angle2 = x * x + y * y + z * z
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    square = np.outer(turn, turn) - angle2 * np.eye(3)
    transition[:3, :3] += (0.5 - angle2 / 24) * square - (1 - angle2 / 6) * cross
    return transition


@compiled
def _by_inertia(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray,
                covariance: np.ndarray, dt_s: float, acceleration_density: np.ndarray,
                drift_density: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    turn = rate * dt_s
    transition = _turn_transition(turn)
    for axis in range(3):
        transition[axis, 3 + axis] = dt_s
    after = transition @ covariance @ transition.T
    for axis in range(3):
        after[axis, axis] += acceleration_density[axis] * dt_s ** 3 / 3
        after[axis, 3 + axis] += acceleration_density[axis] * dt_s ** 2 / 2
        after[3 + axis, axis] += acceleration_density[axis] * dt_s ** 2 / 2
        after[3 + axis, 3 + axis] += acceleration_density[axis] * dt_s
        after[6 + axis, 6 + axis] += drift_density * dt_s
    return turned(quaternion, turn), rate, drift, after


@compiled
def _by_rate(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray, covariance: np.ndarray,
             measured: np.ndarray, dt_s: float, noise_density: float, attitude_variance: float,
             drift_density: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rate = measured - drift
    turn = rate * dt_s
    transition = _turn_transition(turn)
    for axis in range(3):
        transition[axis, 6 + axis] = -dt_s
        transition[3 + axis, 3 + axis] = 0.0
        transition[3 + axis, 6 + axis] = -1.0
    after = transition @ covariance @ transition.T
    for axis in range(3):
        after[axis, axis] += noise_density * dt_s + attitude_variance
        after[axis, 3 + axis] += noise_density
        after[3 + axis, axis] += noise_density
        after[3 + axis, 3 + axis] += noise_density / dt_s
        after[6 + axis, 6 + axis] += drift_density * dt_s
    return turned(quaternion, turn), rate, drift, after


@compiled
def _with_rate(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray, covariance: np.ndarray,
               measured: np.ndarray, variance: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    columns = covariance[:, 3:6] + covariance[:, 6:]
    spread = columns[3:6] + columns[6:] + variance * np.eye(3)
    gain = np.linalg.solve(spread, columns.T).T
    change = gain @ (measured - rate - drift)
    after = covariance - gain @ columns.T
    return (turned(quaternion, change[:3]), rate + change[3:6], drift + change[6:],
            (after + after.T) / 2)


@compiled
def with_attitude(quaternion: np.ndarray, rate: np.ndarray, drift: np.ndarray,
                  covariance: np.ndarray, information: np.ndarray, vector: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return quaternion, rate, drift and covariance as the method of AttitudeState has them."""
    attitude = np.ascontiguousarray(covariance[:3, :3])
    rows = np.ascontiguousarray(covariance[:3])
    columns = np.ascontiguousarray(covariance[:, :3])
    gain = np.linalg.solve(np.eye(3) + information @ attitude, information)
    after = covariance - columns @ gain @ rows
    # Rounding makes it unsymmetric, and what is unsymmetric would grow from frame to frame.
    after = (after + after.T) / 2
    change = np.ascontiguousarray(after[:, :3]) @ vector
    return turned(quaternion, change[:3]), rate + change[3:6], drift + change[6:], after
