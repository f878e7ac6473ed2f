# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The state of the fusion: the motion of the body, and the misalignments of heads beside it.

It is that of motion_filter.py, whose constants are the coefficients c of the mounts. Its error
state about body axes is [attitude rad, rate rad/s, drift rad/s, c], (9 + M,), where
truth = estimate + error and R(truth) = R(estimate) exp([attitude]x).
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import HEAD_DIFFERS
from startracker_ros.core.maths.compiled_rotation import multiplied, rotation_between, turned
from startracker_ros.core.maths.small_algebra import inverse, is_positive_definite
from startracker_ros.core.track.motion_filter import (
    Motion, NOISE_MEMORY, started, state_and_constants, updated)

BODY = 9
"""Elements of the error state that are not of the mounts."""

GATE = HEAD_DIFFERS.threshold
"""Normalised innovation squared that chance exceeds once in a million frames."""


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
    """What a measurement differs from a state by, vector (3,) z; nis is z^T S^-1 z."""

    measured: Measurement
    vector: np.ndarray
    nis: float


class FusedState(NamedTuple):
    """
    The state at a time, of all modes of its motion or by other weights of them.

    quaternion (4,) is q_icrf_from_body; rate and drift (3,) rad/s on body axes, a gyro measures
    their sum; covariance (9 + M, 9 + M) of the error state; coefficients (M,) rad.
    """

    stamp_ns: int
    quaternion: np.ndarray
    rate: np.ndarray
    drift: np.ndarray
    covariance: np.ndarray
    coefficients: np.ndarray
    motion: Motion

    @classmethod
    def of(cls, motion: Motion, weight: np.ndarray | None = None) -> 'FusedState':
        """Return the state of a motion, of its modes or by other weights (M,) of them."""
        state, coefficients = state_and_constants(
            motion, motion.weight if weight is None else weight)
        return cls(*state, coefficients, motion)

    @classmethod
    def begin(cls, state: AttitudeState, noise: np.ndarray, interval_s: float,
              coefficients: np.ndarray) -> 'FusedState':
        """Return the state of a motion of which nothing else is known, as started()."""
        return cls.of(started(state, noise, interval_s, coefficients))

    @property
    def body(self) -> AttitudeState:
        """Return the state without the coefficients; its covariance has them."""
        return AttitudeState(*self[:5])

    def with_unknown_motion(self, rate_sigma: float, drift_sigma: float) -> 'FusedState':
        """Return the state with a rate and a drift (zero) of these 1-sigma errors in rad/s."""
        covariance = self.covariance.copy()
        covariance[3:BODY], covariance[:, 3:BODY] = 0.0, 0.0
        covariance[3:BODY, 3:BODY] = np.diag(np.repeat([rate_sigma ** 2, drift_sigma ** 2], 3))
        return FusedState.begin(
            self.body._replace(drift=np.zeros(3), covariance=covariance), self.motion.noise,
            self.motion.interval_s, self.coefficients)

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

    def updated(self, measured: Measurement, before_ns: int) -> 'FusedState':
        """Return the state of all modes after a measurement; before_ns is the frame before."""
        return FusedState.of(with_head(
            self.motion, before_ns, measured.quaternion, measured.covariance,
            measured.sensitivity, measured.columns.start, self.coefficients[
                measured.columns.start - BODY:measured.columns.stop - BODY]))


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
               first: int) -> tuple[np.ndarray, float]:
    """
    Return z (3,) and z^T S^-1 z, with S = H P H^T + R.

    H = [I 0 0 B], B (3, K) in the columns from first on; R (3, 3) is the covariance of measured.
    """
    last, S = first + B.shape[1], P[:3, :3] + R
    if last > first:
        by_mount = B @ np.ascontiguousarray(P[first:last, :3])
        S += by_mount + by_mount.T + B @ np.ascontiguousarray(P[first:last, first:last]) @ B.T
    z = rotation_between(q, measured)
    return z, z @ inverse(S) @ z


@compiled
def with_head(motion: Motion, before_ns: int, quaternion: np.ndarray, R: np.ndarray, B: np.ndarray,
              first: int, coefficients: np.ndarray) -> Motion:
    """
    Return the motion after a measurement, by coefficients (K,) that were assumed of its mount.

    R (3, 3), B (3, K) and first as in innovation(). The noise of a frame is a mean by
    information: each axis is known from the heads that see it well.
    """
    beside = np.zeros((3, motion.mean.shape[1] - 6))
    beside[:, first - 3:first - 3 + B.shape[1]] = B
    after = updated(motion, quaternion, np.zeros(3), inverse(R), np.zeros(3), beside,
                    B @ coefficients)
    noise, interval_s = after.noise.copy(), after.interval_s
    for axis in range(3):
        noise[axis] = 1 / (NOISE_MEMORY / noise[axis] + (1 - NOISE_MEMORY) / R[axis, axis])
    dt_s = (after.stamp_ns - before_ns) * 1e-9
    if dt_s > 0:
        # Heads have their frames at times of their own, or at one.
        interval_s += (1 - NOISE_MEMORY) * (min(dt_s, 2 * interval_s) - interval_s)
    return Motion(after.stamp_ns, after.quaternion, after.mean, after.covariance, after.weight,
                  after.share, noise, interval_s, after.frames, after.swing)
