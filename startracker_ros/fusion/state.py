"""
The state of the fusion: attitude, rate and gyro drift of the body, and misalignments of heads.

A multiplicative Kalman filter (Lefferts, Markley and Shuster, J. Guid. Control 5, 1982). Its
error state about body axes is [attitude rad, rate rad/s, drift rad/s, coefficients c of the
mounts], (9 + M,), where truth = estimate + error and R(truth) = R(estimate) exp([attitude]x).
"""

from collections.abc import Iterable
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.attitude.gyro import GyroStep
from startracker_ros.maths import quaternion as quaternions
from startracker_ros.maths.compiled_rotation import matrix_from_rotation_vector, turned

BODY = 9
"""Elements of the error state that are not of the mounts."""

GATE = 30.7
"""Normalised innovation squared that chance exceeds once in a million frames (3 degrees)."""

_MAX_TURN_RAD, _MAX_STEP_S = 0.05, 1.0  # of one step of the covariance


class Measurement(NamedTuple):
    """
    A measured attitude of the body.

    quaternion (4,) q_icrf_from_body by the estimated mount, covariance (3, 3) rad^2 about body
    axes. sensitivity (3, K) is d(measured) / d(coefficients) for those of columns, a slice of the
    error state; None for a head whose mount defines the body.
    """

    quaternion: np.ndarray
    covariance: np.ndarray
    columns: slice
    sensitivity: np.ndarray | None


class Innovation(NamedTuple):
    """
    What a measurement adds to a state.

    vector (3,) is z; nis z^T S^-1 z of 3 degrees of freedom, information (3, 3) is S^-1, cross
    (9 + M, 3) is P H^T.
    """

    vector: np.ndarray
    nis: float
    information: np.ndarray
    cross: np.ndarray


class FusedState(NamedTuple):
    """
    The state at a time.

    quaternion (4,) is q_icrf_from_body; rate and drift (3,) rad/s on body axes, a gyro measures
    their sum; coefficients (M,) rad; covariance (9 + M, 9 + M) of the error state.
    """

    stamp_ns: int
    quaternion: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray

    def at_constant_rate(self, to_ns: int, density: float, drift_density: float,
                         walk: np.ndarray) -> 'FusedState':
        """
        Return the state at a later time; the rate is constant but for white acceleration.

        density rad^2/s^3 is that of the acceleration, drift_density that of the change of the
        drift, walk (M,) rad^2/s those of the coefficients.
        """
        dt_s = (to_ns - self.stamp_ns) * 1e-9
        turn = self.rate * dt_s
        F = np.eye(BODY)
        F[:3, :3] = matrix_from_rotation_vector(-turn)
        F.ravel()[_block(0, 1)] = dt_s
        Q = np.zeros((BODY, BODY))
        flat = Q.ravel()
        flat[_block(0, 0)] = density * dt_s ** 3 / 3
        flat[_block(0, 1)] = flat[_block(1, 0)] = density * dt_s ** 2 / 2
        flat[_block(1, 1)] = density * dt_s
        flat[_block(2, 2)] = drift_density * dt_s
        return self._replace(
            stamp_ns=to_ns, quaternion=turned(self.quaternion, turn),
            covariance=_propagated(self.covariance, F, Q, walk * dt_s))

    def at_gyro_rate(self, steps: Iterable[GyroStep], noise_density: float,
                     drift_density: float, walk: np.ndarray) -> 'FusedState':
        """
        Return the state after the steps of a gyro; the rate is the last one minus the drift.

        noise_density rad^2/s is that of the white noise of the gyro, drift_density rad^2/s^3 and
        walk (M,) rad^2/s as above.
        """
        state, turn, variance, elapsed_s = self, np.zeros(3), 0.0, 0.0
        quaternion = self.quaternion
        step: GyroStep | None = None
        for step in steps:
            angle = (step.rate_rad_s - self.drift) * step.dt_s
            quaternion = turned(quaternion, angle)
            turn, variance, elapsed_s = turn + angle, variance + step.variance, (
                elapsed_s + step.dt_s)
            if elapsed_s > _MAX_STEP_S or turn @ turn > _MAX_TURN_RAD ** 2:
                state = state._after_gyro(step, quaternion, turn, elapsed_s, variance,
                                          noise_density, drift_density, walk)
                turn, variance, elapsed_s = np.zeros(3), 0.0, 0.0
        if step is not None and elapsed_s:
            state = state._after_gyro(step, quaternion, turn, elapsed_s, variance,
                                      noise_density, drift_density, walk)
        return state

    def _after_gyro(self, step: GyroStep, quaternion: np.ndarray, turn: np.ndarray, dt_s: float,
                    variance: float, noise_density: float, drift_density: float,
                    walk: np.ndarray) -> 'FusedState':
        """Return the state propagated over dt_s, with attitude error' = -drift error - noise."""
        F = np.eye(BODY)
        F[:3, :3] = matrix_from_rotation_vector(-turn)
        flat = F.ravel()
        flat[_block(0, 2)], flat[_block(1, 1)], flat[_block(1, 2)] = -dt_s, 0.0, -1.0
        Q = np.zeros((BODY, BODY))
        flat = Q.ravel()
        flat[_block(0, 0)] = noise_density * dt_s + drift_density * dt_s ** 3 / 3 + variance
        # The noise of the last rate is a part of that of the turn.
        flat[_block(0, 1)] = flat[_block(1, 0)] = noise_density
        flat[_block(1, 1)] = noise_density / step.dt_s
        flat[_block(0, 2)] = flat[_block(2, 0)] = -drift_density * dt_s ** 2 / 2
        flat[_block(2, 2)] = drift_density * dt_s
        return self._replace(
            stamp_ns=step.until_ns, quaternion=quaternion, rate=step.rate_rad_s - self.drift,
            covariance=_propagated(self.covariance, F, Q, walk * dt_s))

    def innovation(self, measured: Measurement) -> Innovation:
        """Return z = H x + noise, with H = [I 0 0 B] and S = H P H^T + R."""
        P = self.covariance
        cross = P[:, :3]
        if measured.sensitivity is not None:
            B = measured.sensitivity
            cross = cross + P[:, measured.columns] @ B.T
            S = cross[:3] + B @ cross[measured.columns] + measured.covariance
        else:
            S = cross[:3] + measured.covariance
        z = rotation_between(self.quaternion, measured.quaternion)
        information = np.linalg.inv(S)
        return Innovation(z, float(z @ information @ z), information, cross)

    def updated(self, innovation: Innovation) -> 'FusedState':
        """Return the state with x <- x + K z, P <- P - K S K^T, K = P H^T S^-1."""
        gain = innovation.cross @ innovation.information
        change = gain @ innovation.vector
        after = self.covariance - gain @ innovation.cross.T
        return self._replace(
            quaternion=turned(self.quaternion, change[:3]), rate=self.rate + change[3:6],
            drift=self.drift + change[6:BODY], coefficients=self.coefficients + change[BODY:],
            covariance=(after + after.T) / 2)


def _block(row: int, column: int) -> slice:
    """Return the diagonal of a block (3, 3) of a matrix (9, 9), in its elements one by one."""
    first = BODY * 3 * row + 3 * column
    return slice(first, first + 2 * (BODY + 1) + 1, BODY + 1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product a b of two quaternions (4,): first b, then a."""
    # Python's floats: those of NumPy take ten times as long for two quaternions.
    return np.array(quaternions.product(a.tolist(), b.tolist()))


def rotation_between(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) about body axes from q to another attitude, both (4,)."""
    x, y, z, w = q.tolist()
    dx, dy, dz, dw = quaternions.product((-x, -y, -z, w), other.tolist())
    if dw < 0:
        dx, dy, dz, dw = -dx, -dy, -dz, -dw
    sine = math.sqrt(dx * dx + dy * dy + dz * dz)
    scale = 2 * math.atan2(sine, dw) / sine if sine else 2.0
    return np.array([scale * dx, scale * dy, scale * dz])


def _propagated(P: np.ndarray, F: np.ndarray, Q: np.ndarray, walk: np.ndarray) -> np.ndarray:
    """Return F P F^T + Q, where F (9, 9) and Q (9, 9) are of the body, walk (M,) of the rest."""
    after = P.copy()
    after[:BODY] = F @ after[:BODY]
    after[:, :BODY] = after[:, :BODY] @ F.T
    after[:BODY, :BODY] += Q
    after.ravel()[BODY * (len(P) + 1)::len(P) + 1] += walk
    return after
