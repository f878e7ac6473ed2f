"""When an attitude counts as wrong, not merely as noisy."""

import numpy as np
from startracker_ros.maths.rotation import ARCSEC, attitude_error

WRONG_SIGMAS = 5.0
WRONG_ARCSEC = 60.0
"""On any axis, further off than so many of its own sigma and so many arcseconds on top."""


def error_over_bound(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> float:
    """
    Return the largest error over its bound, wrong above 1.

    quaternion and truth (4,) q_icrf_from_sensor, covariance (3, 3) about sensor axes, rad^2.
    """
    error = attitude_error(quaternion, truth)
    bound = WRONG_SIGMAS * np.sqrt(np.diag(covariance)) + WRONG_ARCSEC * ARCSEC
    return float(np.max(np.abs(error) / bound))
