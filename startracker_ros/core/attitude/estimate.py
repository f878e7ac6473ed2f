# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of one frame of identified stars, with its covariance and residuals."""

import numpy as np
from startracker_ros.core.attitude import solution
from startracker_ros.core.attitude.refinement import inverse_information
from startracker_ros.core.attitude.result import (
    AttitudeEstimate, covariance_icrf, failure, FIRST_FAILURE, SOLVERS)

_SOLVER = {'quest': solution.QUEST, 'davenport': solution.DAVENPORT, 'svd': solution.SVD,
           'triad': solution.TRIAD}


class AttitudeError(ValueError):
    """Directions from which no attitude follows; the text says why."""


def estimate_attitude(sensor: np.ndarray, icrf: np.ndarray, sigma_rad: np.ndarray,
                      solver: str = 'quest') -> AttitudeEstimate:
    """
    Return the attitude of directions to the same stars.

    sensor and icrf (N, 3) need not be of unit length; sigma_rad (N,) is the 1-sigma error of
    each sensor direction about either axis across it, the catalogue counts as exact.
    quest, davenport and svd find the maximum likelihood attitude (Wahba's problem), triad
    the one of the two stars that determine it best. The covariance is that of the solver
    at errors of sigma_rad, whatever the residuals: a wrong identification or a mirrored
    image shows in chi2. AttitudeError when no attitude follows.
    """
    # Copies: they are normalised in place, and compiled for arrays of one kind.
    sensor = np.array(sensor, float, order='C')
    icrf = np.array(icrf, float, order='C')
    sigma_rad = np.array(sigma_rad, float, order='C')
    count = len(sigma_rad) if sigma_rad.ndim == 1 else -1
    if sensor.shape != (count, 3) or icrf.shape != (count, 3):
        raise AttitudeError(f'shapes {sensor.shape}, {icrf.shape} and {sigma_rad.shape} '
                            'do not belong to one list of stars')
    if count < 2:
        raise AttitudeError(f'{count} stars: an attitude needs at least 2')
    if solver not in SOLVERS:
        raise ValueError(f'no solver {solver!r}; there are {", ".join(SOLVERS)}')
    status, star, twin, quaternion, covariance, residual_rad, chi2 = solution.solve(
        _SOLVER[solver], sensor, icrf, sigma_rad)
    if status != solution.SOLVED:
        raise AttitudeError(failure(FIRST_FAILURE + status, (
            sigma_rad.min(),) if status == solution.SIGMA else (star, twin)))
    return AttitudeEstimate(quaternion, covariance, count, residual_rad, chi2)


def cramer_rao(sensor: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """
    Return the least covariance (3, 3) rad^2 about sensor axes of any unbiased attitude.

    The inverse Fisher information of unit vectors (N, 3) whose errors across the line of
    sight are Gaussian of sigma_rad (N,) (Shuster and Oh, J. Guid. Control 4, 1981, eq. 98).
    AttitudeError when it is singular.
    """
    least = np.min(sigma_rad)
    covariance, determinant = inverse_information(
        np.array(sensor, float, order='C'), np.square(least / np.array(sigma_rad, float)))
    if determinant <= 0:
        raise AttitudeError('the directions are parallel: they have no information about '
                            'the rotation about them')
    return covariance * least ** 2


def mean_chi2(estimate: AttitudeEstimate, icrf: np.ndarray, sigma_rad: np.ndarray) -> float:
    """
    Return the chi2 that such an estimate of unit vectors icrf (N, 3) has on average.

    2 N - 6 + tr(F P), with F the Fisher information of sigma_rad (N,) and P the covariance of
    the estimate. For the best fit P = F^-1, and it is 2 N - 3.
    """
    covariance = covariance_icrf(estimate.quaternion, estimate.covariance_sensor)
    variance = np.trace(covariance) - np.sum(icrf @ covariance * icrf, 1)
    return float(2 * estimate.stars - 6 + np.sum(variance / np.square(sigma_rad)))
