# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars of one frame fitted by themselves: attitude, lens, residual of each star; compiled."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.lens import Lens, rays, undistorted
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion
from startracker_ros.core.maths.small_algebra import inverse

MATCH_SIGMAS = 5.0
LEAST_STARS = 4
_MOST_LEVERAGE = 0.9


class Stars(NamedTuple):
    """Tracked stars: apparent direction (N, 3), uv (N, 2), sigma_px (N,), magnitude (N,)."""

    direction: np.ndarray
    uv: np.ndarray
    sigma_px: np.ndarray
    magnitude: np.ndarray


class FrameFit(NamedTuple):
    """
    What the centroids of one frame say without those before.

    star (K,) indexes the stars that have a centroid, magnitude (K,) is theirs. turn_rad (3,) about
    sensor axes from the tracked attitude to the best fit, covariance (3, 3). lens (5,) are the
    normal equations of changes f of the focal ratio and k of k1, the attitude eliminated: ff, fk,
    kk, f, k. residual (K, 2) rad to the east and north of each star, as the others see it, sigma
    (K,) rad.
    zero_point (K,) is V + 2.5 log10 flux, NaN where the flux is not positive; zero_point_mag is
    the median.
    """

    star: np.ndarray
    magnitude: np.ndarray
    turn_rad: np.ndarray
    covariance: np.ndarray
    lens: np.ndarray
    residual: np.ndarray
    sigma: np.ndarray
    zero_point: np.ndarray
    zero_point_mag: float


def fit_frame(camera: Camera, quaternion: np.ndarray, stars: Stars, uv: np.ndarray,
              sigma_px: np.ndarray, flux: np.ndarray) -> FrameFit | None:
    """
    Fit the stars that have one of the centroids uv (M, 2) near; None of fewer than four.

    Weighted least squares about an attitude (4,), in tangent coordinates (x, y) = (X, Y) / Z:
    dx = xy a - (1 + x^2) b + y c + x f + x r^2 k, dy = (1 + y^2) a - xy b - x c + y f + y r^2 k
    for a turn (a, b, c) about sensor axes, a change f of the focal ratio and k of k1.
    """
    fit = _fit_matching(camera.lens, camera.pixel_rad, quaternion, Stars(*map(
        np.ascontiguousarray, stars)), *map(np.ascontiguousarray, (uv, sigma_px, flux)))
    return fit if len(fit.star) else None


@compiled
def _fit_matching(lens: Lens, pixel_rad: float, quaternion: np.ndarray, stars: Stars,
                  uv: np.ndarray, sigma_px: np.ndarray, flux: np.ndarray) -> FrameFit:
    """Return the fit of the stars that have a centroid near, one of no star of fewer than four."""
    star, centroid = _match(stars.uv, stars.sigma_px, uv, sigma_px)
    if len(star) < LEAST_STARS:
        return FrameFit(star[:0], np.empty(0), np.empty(0), np.empty((3, 3)), np.empty(0),
                        np.empty((0, 2)), np.empty(0), np.empty(0), np.nan)
    return _fit(lens, pixel_rad, matrix_from_quaternion(quaternion), star, centroid,
                stars.direction, stars.magnitude, uv, sigma_px, flux)


@compiled
def _match(track_uv: np.ndarray, track_sigma_px: np.ndarray, uv: np.ndarray, sigma_px: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray]:
    """Return tracks (K,) and the centroid (K,) nearest to each, if it is within MATCH_SIGMAS."""
    star, centroid = np.empty(len(track_uv), np.int64), np.empty(len(track_uv), np.int64)
    count = 0
    for i in range(len(track_uv)):
        nearest, least = -1, np.inf
        for j in range(len(uv)):
            square = (track_uv[i, 0] - uv[j, 0]) ** 2 + (track_uv[i, 1] - uv[j, 1]) ** 2
            if square < least:
                nearest, least = j, square
        if nearest >= 0 and least <= MATCH_SIGMAS ** 2 * (
                track_sigma_px[i] ** 2 + sigma_px[nearest] ** 2):
            star[count], centroid[count] = i, nearest
            count += 1
    return star[:count], centroid[:count]


@compiled
def _fit(lens: Lens, pixel_rad: float, matrix: np.ndarray, star: np.ndarray,
         centroid: np.ndarray, direction: np.ndarray, magnitude: np.ndarray, uv: np.ndarray,
         sigma_px: np.ndarray, flux: np.ndarray) -> FrameFit:
    count = len(star)
    measured = rays(lens.equidistant, undistorted(lens, np.ascontiguousarray(uv[centroid])))
    J, z, sigma = np.empty((count, 2, 5)), np.empty((count, 2)), np.empty(count)
    normal, vector = np.zeros((5, 5)), np.zeros(5)
    for n in range(count):
        X, Y, Z = _on_sensor(matrix, direction[star[n]])
        x, y = X / Z, Y / Z
        r2 = x * x + y * y
        z[n, 0] = measured[n, 0] / measured[n, 2] - x
        z[n, 1] = measured[n, 1] / measured[n, 2] - y
        sigma[n] = sigma_px[centroid[n]] * pixel_rad
        J[n, 0, 0], J[n, 0, 1], J[n, 0, 2] = x * y, -1 - x * x, y
        J[n, 1, 0], J[n, 1, 1], J[n, 1, 2] = 1 + y * y, -x * y, -x
        J[n, 0, 3], J[n, 0, 4], J[n, 1, 3], J[n, 1, 4] = x, x * r2, y, y * r2
        for axis in range(2):
            for i in range(5):
                vector[i] += J[n, axis, i] * z[n, axis] / sigma[n] ** 2
                for j in range(5):
                    normal[i, j] += J[n, axis, i] * J[n, axis, j] / sigma[n] ** 2
    covariance = inverse(normal)
    turn = covariance @ vector[:3]
    across = np.ascontiguousarray(normal[3:, :3]) @ covariance
    information = normal[3:, 3:] - across @ np.ascontiguousarray(normal[:3, 3:])
    change = vector[3:] - across @ vector[:3]
    residual, zero_point = np.empty((count, 2)), np.empty(count)
    for n in range(count):
        _residual(J[n, :, :3], z[n], sigma[n], turn, covariance, matrix, direction[star[n]],
                  residual[n])
        light = flux[centroid[n]]
        zero_point[n] = magnitude[star[n]] + 2.5 * math.log10(light) if light > 0 else np.nan
    return FrameFit(star, magnitude[star], turn, covariance, np.array([
        information[0, 0], information[0, 1], information[1, 1], change[0], change[1]]),
        residual, sigma, zero_point,
        np.nan if np.isnan(zero_point).any() else np.median(zero_point))


@compiled
def _residual(J: np.ndarray, z: np.ndarray, sigma: float, turn: np.ndarray,
              covariance: np.ndarray, matrix: np.ndarray, direction: np.ndarray,
              residual: np.ndarray) -> None:
    """
    Fill residual (2,), to the east and north, of a star with tangent offset z (2,).

    (z - J turn) / (1 - h), with the leverage h = tr(J P J^T) / (2 sigma^2): the part of its own
    noise that the fit follows, without which the others would hide it.
    """
    leverage, left = 0.0, (0.0, 0.0)
    for axis in range(2):
        value = z[axis]
        for i in range(3):
            value -= J[axis, i] * turn[i]
            for j in range(3):
                leverage += J[axis, i] * covariance[i, j] * J[axis, j] / (2 * sigma ** 2)
        left = left[1], value
    own = 1 - min(leverage, _MOST_LEVERAGE)
    u, v = left[0] / own, left[1] / own
    X, Y, Z = (u * matrix[0, 0] + v * matrix[0, 1], u * matrix[1, 0] + v * matrix[1, 1],
               u * matrix[2, 0] + v * matrix[2, 1])
    x, y, z_icrf = direction
    across = math.hypot(x, y)
    residual[0] = (x * Y - y * X) / across
    residual[1] = (across * across * Z - z_icrf * (x * X + y * Y)) / across


@compiled
def _on_sensor(matrix: np.ndarray, d: np.ndarray) -> tuple[float, float, float]:
    """Return R^T d of a direction (3,) on ICRF axes."""
    return (matrix[0, 0] * d[0] + matrix[1, 0] * d[1] + matrix[2, 0] * d[2],
            matrix[0, 1] * d[0] + matrix[1, 1] * d[1] + matrix[2, 1] * d[2],
            matrix[0, 2] * d[0] + matrix[1, 2] * d[1] + matrix[2, 2] * d[2])
