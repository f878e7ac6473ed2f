"""The stars of one frame fitted by themselves: attitude, lens, residual of each star."""

from typing import NamedTuple

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import matrix_from_quaternion

MATCH_SIGMAS = 5.0
LEAST_STARS = 4


class FrameFit(NamedTuple):
    """
    What the centroids of one frame say without those before.

    turn_rad (3,) about sensor axes from the tracked attitude to the best fit, covariance (3, 3).
    lens_information (2, 2) and lens_vector (2,) are the normal equations of changes of focal
    ratio and of k1, the attitude eliminated. residual (N, 2) arcsec to the east and north of each
    star, as the others see it, sigma (N,) arcsec; star indexes the stars that were fitted.
    """

    turn_rad: np.ndarray
    covariance: np.ndarray
    lens_information: np.ndarray
    lens_vector: np.ndarray
    star: np.ndarray
    residual: np.ndarray
    sigma: np.ndarray


def fit_frame(camera: Camera, quaternion: np.ndarray, direction: np.ndarray, uv: np.ndarray,
              sigma_px: np.ndarray) -> FrameFit | None:
    """
    Fit stars with apparent directions (N, 3) measured at uv (N, 2); None of fewer than four.

    Weighted least squares about an attitude (4,), in tangent coordinates (x, y) = (X, Y) / Z:
    dx = xy a - (1 + x^2) b + y c + x f + x r^2 k, dy = (1 + y^2) a - xy b - x c + y f + y r^2 k
    for a turn (a, b, c) about sensor axes, a change f of the focal ratio and k of k1.
    """
    matrix = matrix_from_quaternion(quaternion)
    sensor = direction @ matrix
    measured = camera.unproject(uv)
    x, y = sensor[:, 0] / sensor[:, 2], sensor[:, 1] / sensor[:, 2]
    tangent = np.stack([x, y], -1)
    difference = measured[:, :2] / measured[:, 2:] - tangent
    sigma = sigma_px * camera.pixel_rad
    if len(x) < LEAST_STARS:
        return None
    r2 = x * x + y * y
    jacobian = np.empty((len(x), 2, 5))
    jacobian[:, 0] = np.stack([x * y, -1 - x * x, y, x, x * r2], -1)
    jacobian[:, 1] = np.stack([1 + y * y, -x * y, -x, y, y * r2], -1)
    weighted = jacobian / sigma[:, None, None] ** 2
    normal = np.einsum('nki,nkj->ij', weighted, jacobian)
    vector = np.einsum('nki,nk->i', weighted, difference)
    covariance = np.linalg.inv(normal[:3, :3])
    turn = covariance @ vector[:3]
    across = normal[3:, :3] @ covariance
    # The part of a star's own noise that the fit follows: without it the others would hide it.
    leverage = np.einsum('nki,ij,nkj->n', weighted[..., :3], covariance, jacobian[..., :3]) / 2
    left = (difference - jacobian[..., :3] @ turn) / (1 - np.minimum(leverage, 0.9))[:, None]
    return FrameFit(
        turn, covariance, normal[3:, 3:] - across @ normal[:3, 3:],
        vector[3:] - across @ vector[:3], np.arange(len(x)),
        _east_north(matrix, direction, left), sigma)


def _east_north(matrix: np.ndarray, direction: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Return small offsets (N, 2) rad on sensor x and y as those to the east and north."""
    offset = tangent @ matrix[:, :2].T
    east = np.stack([-direction[:, 1], direction[:, 0], np.zeros(len(direction))], -1)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(direction, east)
    return np.stack([np.einsum('ni,ni->n', offset, east),
                     np.einsum('ni,ni->n', offset, north)], -1)


def matched(track_uv: np.ndarray, track_sigma_px: np.ndarray, uv: np.ndarray,
            sigma_px: np.ndarray) -> np.ndarray:
    """Return the index (N,) of the centroid of each track (N, 2), -1 where none is near."""
    if not len(uv) or not len(track_uv):
        return np.full(len(track_uv), -1)
    distance = np.linalg.norm(track_uv[:, None] - uv, axis=-1)
    nearest = distance.argmin(axis=1)
    limit = MATCH_SIGMAS * np.hypot(track_sigma_px, sigma_px[nearest])
    return np.where(distance[np.arange(len(nearest)), nearest] <= limit, nearest, -1)
