"""The best attitude of one frame of identified stars, and how good it is."""

from dataclasses import dataclass

import numpy as np

from startracker_ros.attitude.davenport import davenport
from startracker_ros.rotation import matrix_from_quaternion

MIN_EIGENVALUE_GAP = 1e-12
"""Below this gap double precision no longer holds the third axis: rounding alone (2e-16)
would turn it by 2e-4 rad. Two stars of equal weight reach it 0.2 arcsec apart."""


class AttitudeError(ValueError):
    """Directions from which no attitude follows; the text says why."""


@dataclass(frozen=True)
class AttitudeEstimate:
    """An attitude and its statistics.

    quaternion (4,) is q_icrf_from_sensor with w >= 0; covariance_sensor (3, 3) rad^2 is that
    of rotation.attitude_error, a rotation vector about sensor axes; residual_rad (N,) is the
    angle between each star and its catalogue place; chi2 sums the squares of residual over
    sigma, with 2 N - 3 degrees of freedom.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray
    stars: int
    residual_rad: np.ndarray
    chi2: float


def estimate_attitude(sensor: np.ndarray, icrf: np.ndarray, sigma_rad: np.ndarray
                      ) -> AttitudeEstimate:
    """Return the maximum likelihood attitude of directions to the same stars.

    sensor and icrf (N, 3) need not be of unit length; sigma_rad (N,) is the 1-sigma error of
    each sensor direction about either axis across it, the catalogue is taken as exact.
    The covariance is what sigma_rad promises, whatever the residuals: a wrong
    identification or a mirrored image shows in chi2. AttitudeError says why there is none.
    """
    sigma_rad = np.asarray(sigma_rad, float)
    count = len(sigma_rad)
    if np.shape(sensor) != (count, 3) or np.shape(icrf) != (count, 3):
        raise AttitudeError(f'shapes {np.shape(sensor)}, {np.shape(icrf)} and {sigma_rad.shape} '
                            'do not belong to one list of stars')
    if count < 2:
        raise AttitudeError(f'{count} stars: an attitude takes at least 2')
    both = np.array([sensor, icrf], float)
    if not (np.isfinite(both).all() and np.isfinite(sigma_rad).all()):
        raise AttitudeError('NaN or infinity among the directions or their sigma')
    if sigma_rad.min() <= 0:
        raise AttitudeError(f'sigma of {sigma_rad.min():g} rad must be positive')
    length = np.sqrt(np.einsum('kij,kij->ki', both, both))
    if not length.min() > 0:
        raise AttitudeError('a direction of length zero')
    sensor, icrf = both / length[..., None]
    weight = (sigma_rad.min() / sigma_rad) ** 2
    quaternion, gap = davenport(sensor, icrf, weight / weight.sum())
    if gap < MIN_EIGENVALUE_GAP:
        raise AttitudeError('the directions are parallel, or weighted so unevenly that one star '
                            'decides alone: the rotation about them is not observable')
    chord = icrf - sensor @ matrix_from_quaternion(quaternion).T
    half = np.sqrt(np.einsum('ij,ij->i', chord, chord)) / 2
    residual_rad = 2 * np.arcsin(np.minimum(half, 1.0))
    return AttitudeEstimate(quaternion, cramer_rao(sensor, sigma_rad), count, residual_rad,
                            float(np.sum((residual_rad / sigma_rad) ** 2)))


def cramer_rao(sensor: np.ndarray, sigma_rad: np.ndarray) -> np.ndarray:
    """Return the least covariance (3, 3) rad^2 about sensor axes of any unbiased attitude.

    The inverse Fisher information of unit vectors (N, 3) whose errors across the line of
    sight are Gaussian of sigma_rad (N,) (Shuster and Oh, J. Guid. Control 4, 1981, eq. 98).
    AttitudeError when it is singular.
    """
    weight = 1 / np.square(sigma_rad)
    information = np.eye(3) * weight.sum() - (sensor * weight[:, None]).T @ sensor
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError as error:
        raise AttitudeError('the directions are parallel: they have no information about '
                            'the rotation about them') from error
    return (covariance + covariance.T) / 2


def covariance_icrf(q_icrf_from_sensor: np.ndarray, covariance_sensor: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of a rotation vector about sensor axes on ICRF axes."""
    matrix = matrix_from_quaternion(q_icrf_from_sensor)
    return matrix @ covariance_sensor @ matrix.T
