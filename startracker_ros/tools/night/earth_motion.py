# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of a camera that stands on the Earth, or turns on it at a constant rate."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.earth import gcrs_from_itrf
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, multiply, quaternion_from_matrix, quaternion_from_rotation_vector,
    rotation_vector_from_quaternion)
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

_ITERATIONS = 6
_STEP = 1e-6
_OUTLIER_SIGMAS = 6.0
"""Standard deviation of a normal variate over the median of its size."""


class EarthMotion(NamedTuple):
    """
    q_earth_from_sensor(t) = q_start exp(rate t), t in s from stamp_ns.

    The Earth is that of ERFA (frames.gcrs_from_itrf): a camera at rest on it has the rate (3,)
    rad/s zero, on sensor axes, wherever it stands.
    """

    stamp_ns: int
    q_start: np.ndarray
    rate_rad_s: np.ndarray

    def seconds(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return the time (F,) in s of stamps (F,)."""
        return (np.asarray(stamps_ns) - self.stamp_ns) * 1e-9

    def icrf(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return q_icrf_from_sensor (F, 4)."""
        turn = quaternion_from_rotation_vector(
            self.seconds(stamps_ns)[:, None] * self.rate_rad_s)
        return multiply(icrf_from_earth(stamps_ns), multiply(self.q_start, turn))

    def icrf_rate(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return the rate (F, 3) rad/s with respect to ICRF on sensor axes."""
        half_ns = 500_000_000
        return attitude_error(self.icrf(stamps_ns + half_ns), self.icrf(stamps_ns - half_ns))


def icrf_from_earth(stamps_ns: np.ndarray) -> np.ndarray:
    """Return the rotations (F, 4) from Earth-fixed to ICRF axes at stamps (F,)."""
    return np.array([quaternion_from_matrix(gcrs_from_itrf(epoch_year_from_stamp(int(stamp))))
                     for stamp in stamps_ns])


def fit_motion(stamps_ns: np.ndarray, quaternions: np.ndarray, tracking: bool) -> EarthMotion:
    """
    Return the motion that fits attitudes q_icrf_from_sensor (F, 4) best, wrong ones left out.

    The rate is fitted in both cases: that of a tripod starts from zero, so that few frames far
    apart are enough, that of a mount from the turns between neighbours, each below 180 deg.
    """
    middle = len(stamps_ns) // 2
    stamp_ns = int(stamps_ns[middle])
    time_s = (stamps_ns - stamp_ns) * 1e-9
    earth = multiply(conjugate(icrf_from_earth(stamps_ns)), quaternions)
    rate = np.zeros(3)
    if tracking:
        turns = rotation_vector_from_quaternion(multiply(conjugate(earth[:-1]), earth[1:]))
        rate = np.median(turns / np.diff(time_s)[:, None], axis=0)
    return _least_squares(stamp_ns, time_s, earth, _typical(time_s, earth, rate), rate)


def _typical(time_s: np.ndarray, earth: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the attitude at time 0 that agrees best with half of those measured."""
    start = multiply(earth, quaternion_from_rotation_vector(-time_s[:, None] * rate))
    distance = [np.median(np.linalg.norm(attitude_error(start, each), axis=1)) for each in start]
    return start[int(np.argmin(distance))]


def _least_squares(stamp_ns: int, time_s: np.ndarray, earth: np.ndarray, q_start: np.ndarray,
                   rate: np.ndarray) -> EarthMotion:
    """Return the fit by Gauss-Newton steps of start and rate, both in rad over the night."""
    scale = np.repeat([1.0, 1 / np.abs(time_s).max()], 3)
    for _ in range(_ITERATIONS):
        error = _errors(time_s, earth, q_start, rate)
        moved = [_errors(time_s, earth, *_stepped(q_start, rate, _STEP * axis))
                 for axis in np.diag(scale)]
        jacobian = (np.stack(moved, axis=-1) - error[..., None]) / _STEP
        good = inliers(error - np.median(error, axis=0))
        step, *_ = np.linalg.lstsq(jacobian[good].reshape(-1, 6), -error[good].ravel(), None)
        q_start, rate = _stepped(q_start, rate, step * scale)
    return EarthMotion(stamp_ns, q_start, rate)


def _stepped(q_start: np.ndarray, rate: np.ndarray, step: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return start and rate after a step (6,) of both."""
    return multiply(q_start, quaternion_from_rotation_vector(step[:3])), rate + step[3:]


def _errors(time_s: np.ndarray, earth: np.ndarray, q_start: np.ndarray, rate: np.ndarray
            ) -> np.ndarray:
    """Return the errors (F, 3) rad of attitudes (F, 4) on the Earth about a motion."""
    turn = quaternion_from_rotation_vector(time_s[:, None] * rate)
    return attitude_error(earth, multiply(q_start, turn))


def inliers(errors: np.ndarray) -> np.ndarray:
    """Return which errors (N, A) are within the scatter of most of them."""
    size = np.linalg.norm(errors, axis=-1)
    return size <= _OUTLIER_SIGMAS * SIGMA_PER_MAD * np.median(size) + 1e-12
