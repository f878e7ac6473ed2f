"""
When an attitude is correct, and when it is wrong.

An identification is correct within fixed angles of the truth. A published attitude is wrong when
its error exceeds what its own covariance allows: a large error with a large covariance is noise.
"""

import numpy as np
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error

CORRECT_BORESIGHT_DEG = 0.05
CORRECT_ROLL_DEG = 0.5
CORRECT_TEXT = (f'boresight within {CORRECT_BORESIGHT_DEG:g} deg, '
                f'roll within {CORRECT_ROLL_DEG:g} deg')

WRONG_SIGMAS = 5.0
WRONG_ARCSEC = 60.0
WRONG_TEXT = (f'off by more than {WRONG_SIGMAS:g} sigma of its own covariance and '
              f'{WRONG_ARCSEC:g} arcsec on any axis')


def is_correct(quaternion: np.ndarray, truth: np.ndarray) -> bool:
    """Return whether q_icrf_from_sensor (4,) is within both angles of the truth (4,)."""
    x, y, roll = np.degrees(attitude_error(quaternion, truth))
    return bool(np.hypot(x, y) < CORRECT_BORESIGHT_DEG and abs(roll) < CORRECT_ROLL_DEG)


def over_bound(error_rad: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """Return the largest ratio (...) of errors (..., 3) to their bounds, wrong above 1."""
    bound_rad = WRONG_SIGMAS * sigma_rad + WRONG_ARCSEC * ARCSEC
    return np.max(np.abs(error_rad) / bound_rad, axis=-1)


def error_over_bound(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> float:
    """
    Return the largest ratio of the errors about sensor axes to their bounds, wrong above 1.

    quaternion and truth (4,) q_icrf_from_sensor, covariance (3, 3) about sensor axes, rad^2.
    """
    sigma_rad = np.sqrt(np.diag(covariance))
    return float(over_bound(attitude_error(quaternion, truth), sigma_rad))


def is_wrong(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> bool:
    """Return whether the error of an attitude exceeds its bound on any axis."""
    return error_over_bound(quaternion, covariance, truth) > 1
