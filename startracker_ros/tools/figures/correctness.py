# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
When an attitude is correct, and when it is wrong.

An identification is correct within fixed angles of the truth. A published attitude is wrong when
its error exceeds what its own covariance allows, whatever its size: a large error with a large
covariance is noise, a small one with a covariance too small misleads a filter that uses it.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error

CORRECT_BORESIGHT_DEG = 0.05
CORRECT_ROLL_DEG = 0.5
CORRECT_TEXT = (f'boresight within {CORRECT_BORESIGHT_DEG:g} deg, '
                f'roll within {CORRECT_ROLL_DEG:g} deg')

WRONG_SHARE = 1e-4
"""Share of the published attitudes that may be wrong in a supported condition."""

GROSS_ARCSEC = 60.0
WRONG_TEXT = (f'off by more than {WRONG_SIGMAS:g} sigma of its own covariance on any axis; gross: '
              f'by more than {GROSS_ARCSEC:g} arcsec as well')


class WrongCount(NamedTuple):
    """How many of some attitudes are wrong, and how many of these gross."""

    wrong: int
    gross: int


NOT_WRONG = WrongCount(0, 0)


def is_correct(quaternion: np.ndarray, truth: np.ndarray) -> bool:
    """Return whether q_icrf_from_sensor (4,) is within both angles of the truth (4,)."""
    x, y, roll = np.degrees(attitude_error(quaternion, truth))
    return bool(np.hypot(x, y) < CORRECT_BORESIGHT_DEG and abs(roll) < CORRECT_ROLL_DEG)


def over_bound(error_rad: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """Return the largest ratio (...) of errors (..., 3) to WRONG_SIGMAS sigma, wrong above 1."""
    return np.max(np.abs(error_rad) / (WRONG_SIGMAS * sigma_rad), axis=-1)


def count_wrong(error_rad: np.ndarray, sigma_rad: np.ndarray) -> WrongCount:
    """Count the wrong attitudes among errors (..., 3) about sensor axes; NaN is not wrong."""
    beyond = np.abs(error_rad) > WRONG_SIGMAS * sigma_rad
    gross = beyond & (np.abs(error_rad) > GROSS_ARCSEC * ARCSEC)
    return WrongCount(int(np.count_nonzero(beyond.any(axis=-1))),
                      int(np.count_nonzero(gross.any(axis=-1))))


def nees_of(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the normalised squares e^T P^-1 e (N,) of errors (N, 3), mean 3 if P is true."""
    return np.einsum('ni,ni->n', error, np.linalg.solve(covariance, error[..., None])[..., 0])


def verdict(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> WrongCount:
    """
    Return whether an attitude is wrong and whether it is gross, each 0 or 1.

    quaternion and truth (4,) q_icrf_from_sensor, covariance (3, 3) about sensor axes, rad^2.
    """
    return count_wrong(attitude_error(quaternion, truth), np.sqrt(np.diag(covariance)))


def error_over_bound(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> float:
    """Return over_bound() of one attitude, with the arguments of verdict()."""
    sigma_rad = np.sqrt(np.diag(covariance))
    return float(over_bound(attitude_error(quaternion, truth), sigma_rad))


def is_wrong(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> bool:
    """Return whether the error of an attitude exceeds WRONG_SIGMAS sigma on any axis."""
    return verdict(quaternion, covariance, truth).wrong > 0


def right_and_wrong(identified: np.ndarray, hip: np.ndarray) -> tuple[int, int]:
    """Return the numbers of correctly and of falsely identified stars."""
    return (int(np.count_nonzero((identified > 0) & (identified == hip))),
            int(np.count_nonzero((identified > 0) & (identified != hip))))
