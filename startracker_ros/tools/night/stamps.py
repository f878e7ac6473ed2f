# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of the stamps and of the times of rows, as far as the motion shows them."""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.tools.night.intervals import Interval, root, successive_sigma, UNKNOWN
from startracker_ros.tools.night.patterns import single_coefficient
from startracker_ros.tools.night.stars import Stars

_SIGMAS = 1.96
_SLOWEST_RAD_S = 1e-9


def stamp_jitter_s(errors: np.ndarray, covariance: np.ndarray, rate_rad_s: np.ndarray,
                   joined: np.ndarray) -> Interval:
    """
    Return the scatter of the stamps by errors (F, 3) rad of attitudes turning at rate (3,) rad/s.

    An error of a stamp is a turn along the motion. What errors along it have more than those
    across it, both across the boresight, is that of the stamps. covariance (F, 3, 3) are the
    errors that the stars state, for their ratio.
    """
    rate = rate_rad_s[:2]
    speed = float(np.linalg.norm(rate))
    if speed < _SLOWEST_RAD_S:
        return UNKNOWN
    axes = np.array([rate, [-rate[1], rate[0]]]) / speed
    along, across = (successive_sigma(errors[:, :2] @ axis[:, None], joined) for axis in axes)
    stated = [float(np.mean(np.einsum('i,fij,j->f', axis, covariance[:, :2, :2], axis)))
              for axis in axes]
    expected = across.value ** 2 * stated[0] / stated[1]
    count = int(np.count_nonzero(joined))
    degrees = 2 * count ** 2 / max(3 * count - 1, 1)
    sigma = np.sqrt(2 * (along.value ** 4 + expected ** 2) / degrees)
    square = along.value ** 2 - expected
    return root(square, float(sigma), square > _SIGMAS * sigma).scaled(1 / speed)


def line_time_s(stars: Stars, camera: Camera, rates_rad_s: np.ndarray, degree: int) -> Interval:
    """Return the delay from row to row by residuals of frames turning at rates (F, 3) rad/s."""
    flow = np.einsum('nki,ni->nk', stars.jacobian, rates_rad_s[stars.frame])
    rows = stars.uv[:, 1] - (camera.height - 1) / 2
    return single_coefficient(stars, camera, flow * rows[:, None], degree)
