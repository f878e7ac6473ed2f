# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of one frame of identified stars, with its covariance and residuals."""

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.result import (
    AttitudeEstimate, covariance_icrf, failure, SOLVERS)

# Of the least eigenvalue of the information to its trace that is observable: MIN_GAP of
# native/src/attitude/refinement.h.
_OBSERVABLE = 1e-12 / 4


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
    sensor, icrf, sigma_rad = (
        np.ascontiguousarray(array, float) for array in (sensor, icrf, sigma_rad))
    count = len(sigma_rad) if sigma_rad.ndim == 1 else -1
    if sensor.shape != (count, 3) or icrf.shape != (count, 3):
        raise AttitudeError(f'shapes {sensor.shape}, {icrf.shape} and {sigma_rad.shape} '
                            'do not belong to one list of stars')
    if count < 2:
        raise AttitudeError(f'{count} stars: an attitude needs at least 2')
    if solver not in SOLVERS:
        raise ValueError(f'no solver {solver!r}; there are {", ".join(SOLVERS)}')
    found, reason = np.zeros((), native.ATTITUDE), np.zeros((), native.REASON)
    residual_rad, work = np.empty(count), np.empty(512 + 64 * count, np.uint8)
    native.call('st_fit_attitude', SOLVERS.index(solver), sensor, icrf, sigma_rad, count, found,
                residual_rad, reason, work, len(work))
    if reason['code']:
        raise AttitudeError(failure(int(reason['code']), reason['figure'].tolist()))
    return AttitudeEstimate(found['quaternion'].copy(), found['covariance_rad2'].copy(), count,
                            residual_rad, float(found['chi2']))


def information(directions: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """
    Return the Fisher information (3, 3) of unit vectors p (N, 3) with errors sigma (N,).

    Sum of (I - p p^T) / sigma^2; its diagonal as sums of squares keeps the digits of close stars.
    """
    p, weight = np.asarray(directions, float), np.asarray(sigma_rad, float) ** -2.0
    F = -(weight * p.T) @ p
    np.fill_diagonal(F, weight @ (p[:, [1, 0, 0]] ** 2 + p[:, [2, 2, 1]] ** 2))
    return F


def cramer_rao(sensor: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """
    Return the least covariance (3, 3) rad^2 about sensor axes of any unbiased attitude.

    The inverse Fisher information of unit vectors (N, 3) whose errors across the line of
    sight are Gaussian of sigma_rad (N,) (Shuster and Oh, J. Guid. Control 4, 1981, eq. 98).
    AttitudeError when it is singular.
    """
    F = information(sensor, sigma_rad)
    if not np.linalg.eigvalsh(F)[0] > _OBSERVABLE * np.trace(F):
        raise AttitudeError('the directions are parallel: they have no information about '
                            'the rotation about them')
    return np.linalg.inv(F)


def mean_chi2(estimate: AttitudeEstimate, icrf: np.ndarray, sigma_rad: np.ndarray) -> float:
    """
    Return the chi2 that such an estimate of unit vectors icrf (N, 3) has on average.

    2 N - 6 + tr(F P), with F the Fisher information of sigma_rad (N,) and P the covariance of
    the estimate. For the best fit P = F^-1, and it is 2 N - 3.
    """
    covariance = covariance_icrf(estimate.quaternion, estimate.covariance_sensor)
    variance = np.trace(covariance) - np.sum(icrf @ covariance * icrf, 1)
    return float(2 * estimate.stars - 6 + np.sum(variance / np.square(sigma_rad)))
