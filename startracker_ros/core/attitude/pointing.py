# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The errors of right ascension, declination and roll."""

import numpy as np
from startracker_ros.core.maths.rotation import east_and_north, matrix_from_quaternion


def pointing_sigma(q_icrf_from_sensor: np.ndarray, covariance_icrf: np.ndarray) -> np.ndarray:
    """
    Return 1 sigma (3,) in rad of the boresight eastward and northward, and of the roll about it.

    Eastward is right ascension times cos(declination); covariance_icrf (3, 3) is that of a
    rotation vector about ICRF axes.
    """
    boresight = matrix_from_quaternion(q_icrf_from_sensor)[:, 2]
    east, north = east_and_north(boresight)
    # A rotation about the north moves the boresight to the east.
    axes = np.stack([north, east, boresight])
    return np.sqrt(np.diag(axes @ covariance_icrf @ axes.T))
