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
from startracker_ros.core.fusion import filter_steps
from startracker_ros.core.maths.compiled_rotation import turned
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.small_algebra import is_positive_definite

BODY = 9
"""Elements of the error state that are not of the mounts."""

GATE = gate(1e-6, 3)
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
        return FusedState(*body[:4], self.coefficients, filter_steps.with_body(
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
            covariance=filter_steps.propagated(
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
            covariance=filter_steps.propagated(
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
        return Innovation(measured, *filter_steps.innovation(
            self.quaternion, self.covariance, measured.quaternion, measured.covariance,
            measured.sensitivity, measured.columns.start))

    def updated(self, innovation: Innovation) -> 'FusedState':
        """Return the state with x <- x + K z, P <- P - K S K^T, K = P H^T S^-1."""
        change, covariance = filter_steps.correction(
            self.covariance, innovation.vector, innovation.information, innovation.cross)
        return self._replace(
            quaternion=turned(self.quaternion, change[:3]), rate=self.rate + change[3:6],
            drift=self.drift + change[6:BODY], coefficients=self.coefficients + change[BODY:],
            covariance=covariance)
