"""An attitude with its statistics. Free of compiled code, which is slow to import."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.maths.rotation import matrix_from_quaternion

SOLVERS = ('quest', 'davenport', 'svd', 'triad')
"""The solvers: three of the same best fit, and the two best stars alone."""


@dataclass(frozen=True)
class AttitudeEstimate:
    """
    An attitude and its statistics.

    quaternion (4,) is q_icrf_from_sensor with w >= 0; covariance_sensor (3, 3) rad^2 is that
    of rotation.attitude_error, a rotation vector about sensor axes; residual_rad (N,) is the
    angle between each star and its catalogue direction; chi2 sums the squares of residual over
    sigma: of the best fit with 2 N - 3 degrees of freedom, else with mean_chi2() as its mean.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray
    stars: int
    residual_rad: np.ndarray
    chi2: float


def covariance_icrf(q_icrf_from_sensor: np.ndarray, covariance_sensor: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of a rotation vector about sensor axes on ICRF axes."""
    matrix = matrix_from_quaternion(q_icrf_from_sensor)
    return matrix @ covariance_sensor @ matrix.T
