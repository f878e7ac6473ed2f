"""An attitude with its statistics. Free of compiled code, which is slow to import."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import matrix_from_quaternion

SOLVERS = ('quest', 'davenport', 'svd', 'triad')
"""The solvers: three of the same best fit, and the two best stars alone."""

_IDENTITY = np.eye(3)


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


def with_velocity_error(attitude: AttitudeEstimate, velocity_sigma_m_s: float,
                        sensor: np.ndarray, sigma: np.ndarray) -> AttitudeEstimate:
    """
    Return an attitude whose covariance contains an unknown velocity, of 1 sigma on each axis.

    sensor (N, 3) are the directions p of its stars, sigma (N,) their errors in any unit, w =
    1 / sigma^2. A velocity v shifts a star by (v - (v.p) p) / c, which turns the best fit by
    F^-1 (s x v) / c with F = sum w (I - p p^T) and s = sum w p: about the axes across the
    boresight by v / c, about the boresight by some v / c times the angle of the field. The
    covariance of the turn is (sigma_v / c)^2 F^-1 (s^2 I - s s^T) F^-1.
    """
    if not velocity_sigma_m_s:
        return attitude
    weight = 1 / np.square(sigma)
    s, F_inverse = weight @ sensor, np.linalg.inv(_information(weight, sensor))
    turn = F_inverse @ (s @ s * _IDENTITY - s[:, None] * s) @ F_inverse
    variance = (velocity_sigma_m_s / SPEED_OF_LIGHT_M_S) ** 2
    return replace(attitude, covariance_sensor=attitude.covariance_sensor + variance * turn)


def with_lens_error(attitude: AttitudeEstimate, lens_sigma: float, scale: float,
                    sensor: np.ndarray, sigma: np.ndarray) -> AttitudeEstimate:
    """
    Return an attitude whose covariance contains errors of the lens, of 1 sigma per axis and star.

    sensor and sigma are those of with_velocity_error(), in rad as is lens_sigma. The errors are
    independent between stars and the same in each frame: sigma_l^2 F^-1 G F^-1 is added, with G
    = sum w^2 (I - p p^T). A scale, the relative error of the distances from the axis z, moves
    stars by scale (p - z), which turns the best fit by scale F^-1 sum w p_z (-p_y, p_x, 0).
    """
    if not (lens_sigma or scale):
        return attitude
    weight = 1 / np.square(sigma)
    F_inverse = np.linalg.inv(_information(weight, sensor))
    G = _information(np.square(weight), sensor)
    x, y, z = sensor.T
    turn = scale * F_inverse @ [-(weight * z) @ y, (weight * z) @ x, 0.0]
    return replace(attitude, covariance_sensor=attitude.covariance_sensor
                   + lens_sigma ** 2 * F_inverse @ G @ F_inverse + np.outer(turn, turn))


LEAST_FLOW_PX_S = 10.0


def pointing_covariance(common_px2: np.ndarray, camera: Camera,
                        rate: np.ndarray | None = None) -> np.ndarray:
    """
    Return the covariance (3, 3) rad^2 about sensor axes of a shift of all stars, (2, 2) px^2.

    In the middle of the image a turn x, y of the sensor moves stars by (-f_u y, f_v x) px. Where
    the body turns with a rate (3,) rad/s, a shift along the flow f of the stars is one of time,
    by f / f^2, which turns the body about the boresight as well.
    """
    turn = np.array([[0.0, 1 / camera.fy], [-1 / camera.fx, 0.0], [0.0, 0.0]])
    if rate is not None:
        flow = np.array([-camera.fx * rate[1], camera.fy * rate[0]])
        turn[2] = rate[2] * flow / (flow @ flow + LEAST_FLOW_PX_S ** 2)
    return turn @ common_px2 @ turn.T


def with_common_error(attitude: AttitudeEstimate, common_px2: np.ndarray, camera: Camera
                      ) -> AttitudeEstimate:
    """Return an attitude whose covariance contains an error (2, 2) px^2 that all stars share."""
    return replace(attitude, covariance_sensor=attitude.covariance_sensor
                   + pointing_covariance(common_px2, camera))


def _information(weight: np.ndarray, sensor: np.ndarray) -> np.ndarray:
    """Return sum w (I - p p^T), of weights w (N,) and directions p (N, 3)."""
    return weight.sum() * _IDENTITY - (sensor * weight[:, None]).T @ sensor
