# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

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
from startracker_ros.core.attitude.attitude_state import AttitudeState, Prediction
from startracker_ros.core.attitude.gyro import GyroStep
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import HEAD_DIFFERS
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_rotation_vector, multiplied, rotation_between, turned)
from startracker_ros.core.maths.small_algebra import adjugate, is_positive_definite

BODY = 9
"""Elements of the error state that are not of the mounts."""

GATE = HEAD_DIFFERS.threshold
"""Normalised innovation squared that chance exceeds once in a million frames."""

_MAX_TURN_RAD, _MAX_STEP_S = 0.05, 1.0  # of one step of the covariance


class Measurement(NamedTuple):
    """
    A measured attitude of the body.

    quaternion (4,) q_icrf_from_body by the estimated mount, covariance (3, 3) rad^2 about body
    axes. sensitivity (3, K) is d(measured) / d(coefficients) for those of columns, a slice of the
    error state; K is 0 for a head whose mount defines the body.
    """

    quaternion: np.ndarray
    covariance: np.ndarray
    columns: slice
    sensitivity: np.ndarray


class Innovation(NamedTuple):
    """
    What a measurement adds to a state.

    measured is the measurement, vector (3,) is z; nis z^T S^-1 z of 3 degrees of freedom,
    information (3, 3) is S^-1, cross (9 + M, 3) is P H^T.
    """

    measured: Measurement
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

    @property
    def body(self) -> AttitudeState:
        """Return the state without the mounts."""
        return AttitudeState(*self[:4], np.ascontiguousarray(self.covariance[:BODY, :BODY]))

    def after(self, prediction: Prediction, walk: np.ndarray) -> 'FusedState':
        """Return the state with a later one of the body; walk (M,) rad^2/s as below."""
        body = prediction.state
        return FusedState(*body[:4], self.coefficients, with_body(
            self.covariance, body.covariance, prediction.transition,
            walk * ((body.stamp_ns - self.stamp_ns) * 1e-9)))

    def at_constant_rate(self, to_ns: int, density: float, drift_density: float,
                         walk: np.ndarray) -> 'FusedState':
        """
        Return the state at a later time; the rate is constant but for white acceleration.

        density rad^2/s^3 is that of the acceleration, drift_density that of the change of the
        drift, walk (M,) rad^2/s those of the coefficients.
        """
        dt_s = (to_ns - self.stamp_ns) * 1e-9
        turn = self.rate * dt_s
        noise = (density * dt_s ** 3 / 3, density * dt_s ** 2 / 2, density * dt_s, 0.0,
                 drift_density * dt_s)
        return self._replace(
            stamp_ns=to_ns, quaternion=turned(self.quaternion, turn),
            covariance=propagated(
                self.covariance, turn, (dt_s, 0.0, 1.0, 0.0), noise, walk * dt_s))

    def at_gyro_rate(self, steps: Iterable[GyroStep], drift_density: float, walk: np.ndarray
                     ) -> 'FusedState':
        """
        Return the state after the steps of a gyro; the rate is the last one minus the drift.

        drift_density rad^2/s^3 and walk (M,) rad^2/s as above.
        """
        state, turn, variance, elapsed_s = self, np.zeros(3), 0.0, 0.0
        quaternion = self.quaternion
        step: GyroStep | None = None
        for step in steps:
            angle = (step.rate_rad_s - self.drift) * step.dt_s
            quaternion = turned(quaternion, angle)
            turn, elapsed_s = turn + angle, elapsed_s + step.dt_s
            variance += step.noise_density * step.dt_s + step.variance
            if elapsed_s > _MAX_STEP_S or turn @ turn > _MAX_TURN_RAD ** 2:
                state = state._after_gyro(
                    step, quaternion, turn, elapsed_s, variance, drift_density, walk)
                turn, variance, elapsed_s = np.zeros(3), 0.0, 0.0
        if step is not None and elapsed_s:
            state = state._after_gyro(
                step, quaternion, turn, elapsed_s, variance, drift_density, walk)
        return state

    def _after_gyro(self, step: GyroStep, quaternion: np.ndarray, turn: np.ndarray, dt_s: float,
                    variance: float, drift_density: float, walk: np.ndarray) -> 'FusedState':
        """Return the state propagated over dt_s, with attitude error' = -drift error - noise."""
        # The noise of the last rate is a part of that of the turn.
        noise = (variance + drift_density * dt_s ** 3 / 3, step.noise_density,
                 step.noise_density / step.dt_s, -drift_density * dt_s ** 2 / 2,
                 drift_density * dt_s)
        return self._replace(
            stamp_ns=step.until_ns, quaternion=quaternion, rate=step.rate_rad_s - self.drift,
            covariance=propagated(
                self.covariance, turn, (0.0, -dt_s, 0.0, -1.0), noise, walk * dt_s))

    def with_unknown_motion(self, rate_sigma: float, drift_sigma: float) -> 'FusedState':
        """Return the state with a rate and a drift (zero) of these 1-sigma errors in rad/s."""
        covariance = self.covariance.copy()
        covariance[3:BODY], covariance[:, 3:BODY] = 0.0, 0.0
        covariance[3:BODY, 3:BODY] = np.diag(np.repeat([rate_sigma ** 2, drift_sigma ** 2], 3))
        return self._replace(drift=np.zeros(3), covariance=covariance)

    @property
    def has_covariance(self) -> bool:
        """Whether the covariance is one: finite, no variance negative, positive definite."""
        P = self.covariance
        return bool(math.isfinite(P.sum()) and min(np.diagonal(P).tolist()) >= 0
                    and is_positive_definite(P))

    def innovation(self, measured: Measurement) -> Innovation:
        """Return z = H x + noise, with H = [I 0 0 B] and S = H P H^T + R."""
        return Innovation(measured, *innovation(
            self.quaternion, self.covariance, measured.quaternion, measured.covariance,
            measured.sensitivity, measured.columns.start))

    def updated(self, innovation: Innovation) -> 'FusedState':
        """Return the state with x <- x + K z, P <- P - K S K^T, K = P H^T S^-1."""
        change, covariance = correction(
            self.covariance, innovation.vector, innovation.information, innovation.cross)
        return self._replace(
            quaternion=turned(self.quaternion, change[:3]), rate=self.rate + change[3:6],
            drift=self.drift + change[6:BODY], coefficients=self.coefficients + change[BODY:],
            covariance=covariance)


# --- compiled steps of the filter, with P (9 + M, 9 + M) the covariance, symmetric ---

Transition = tuple[float, float, float, float]
"""a, b, c, d of F = [A a b; 0 c d; 0 0 1] in blocks of three, A = exp(-[turn]x)."""

Noise = tuple[float, float, float, float, float]
"""Diagonals of the blocks of Q: attitude, attitude and rate, rate, attitude and drift, drift."""


@compiled
def _transformed(P: np.ndarray, A: np.ndarray, F: Transition) -> np.ndarray:
    """Return F P, P (9 + M, K)."""
    a, b, c, d = F
    after = P.copy()
    for j in range(P.shape[1]):
        for i in range(3):
            after[i, j] = (A[i, 0] * P[0, j] + A[i, 1] * P[1, j] + A[i, 2] * P[2, j]
                           + a * P[3 + i, j] + b * P[6 + i, j])
            after[3 + i, j] = c * P[3 + i, j] + d * P[6 + i, j]
    return after


@compiled
def propagated(P: np.ndarray, turn: np.ndarray, F: Transition, Q: Noise, walk: np.ndarray
               ) -> np.ndarray:
    """Return F P F^T + Q after a turn (3,) rad; walk (M,) rad^2 are the variances of mounts."""
    A = matrix_from_rotation_vector(-turn)
    # P is symmetric: F (F P)^T is F P F^T.
    half = _transformed(P, A, F)
    after = _transformed(np.ascontiguousarray(half.T), A, F)
    for i in range(3):
        after[i, i] += Q[0]
        after[i, 3 + i] += Q[1]
        after[3 + i, i] += Q[1]
        after[3 + i, 3 + i] += Q[2]
        after[i, 6 + i] += Q[3]
        after[6 + i, i] += Q[3]
        after[6 + i, 6 + i] += Q[4]
    for i in range(len(walk)):
        after[9 + i, 9 + i] += walk[i]
    return after


@compiled
def with_body(P: np.ndarray, body: np.ndarray, F: np.ndarray, walk: np.ndarray) -> np.ndarray:
    """Return P after a step in which the body has got a covariance (9, 9) by F (9, 9)."""
    after, size = P.copy(), len(body)
    after[:size, :size] = body
    for j in range(size, len(P)):
        for i in range(size):
            total = 0.0
            for k in range(size):
                total += F[i, k] * P[k, j]
            after[i, j] = after[j, i] = total
        after[j, j] += walk[j - size]
    return after


@compiled
def body_attitude(q: np.ndarray, sensor_from_body: np.ndarray, matrix: np.ndarray,
                  C: np.ndarray, B: np.ndarray, c: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return q_icrf_from_body (4,) by a head, and its covariance M C M^T (3, 3) about body axes.

    q (4,) is q_icrf_from_sensor, C (3, 3) its covariance about sensor axes; sensor_from_body (4,)
    and matrix (3, 3) M, body from sensor, are the mount, B c its misalignment.
    """
    after = multiplied(q, sensor_from_body)
    if len(c):
        misalignment = np.zeros(3)
        for i in range(3):
            for k in range(len(c)):
                misalignment[i] -= B[i, k] * c[k]
        after = turned(after, misalignment)
    half, covariance = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                half[i, j] += matrix[i, k] * C[k, j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                covariance[i, j] += half[i, k] * matrix[j, k]
    return after, covariance


@compiled
def innovation(q: np.ndarray, P: np.ndarray, measured: np.ndarray, R: np.ndarray, B: np.ndarray,
               first: int) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """
    Return z (3,), z^T S^-1 z, S^-1 (3, 3) and P H^T (9 + M, 3), S = H P H^T + R.

    H = [I 0 0 B], B (3, K) in the columns from first on; R (3, 3) is the covariance of measured.
    """
    cross, S = np.empty((len(P), 3)), R.copy()
    for i in range(len(P)):
        for j in range(3):
            total = P[i, j]
            for k in range(B.shape[1]):
                total += P[i, first + k] * B[j, k]
            cross[i, j] = total
    for i in range(3):
        for j in range(3):
            S[i, j] += cross[i, j]
            for k in range(B.shape[1]):
                S[i, j] += B[i, k] * cross[first + k, j]
    z = rotation_between(q, measured)
    xx, xy, xz, yy, yz, zz = adjugate(S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2])
    determinant = S[0, 0] * xx + S[0, 1] * xy + S[0, 2] * xz
    information = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))) / determinant
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += z[i] * information[i, j] * z[j]
    return z, nis, information, cross


@compiled
def correction(P: np.ndarray, z: np.ndarray, information: np.ndarray, cross: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return K z (9 + M,) and P - K S K^T, K = P H^T S^-1."""
    size = len(P)
    change, gain, after = np.zeros(size), np.zeros((size, 3)), np.empty((size, size))
    for i in range(size):
        for j in range(3):
            for k in range(3):
                gain[i, j] += cross[i, k] * information[k, j]
            change[i] += gain[i, j] * z[j]
    for i in range(size):
        for j in range(i + 1):
            total = P[i, j]
            for k in range(3):
                total -= gain[i, k] * cross[j, k]
            after[i, j] = after[j, i] = total
    return change, after
