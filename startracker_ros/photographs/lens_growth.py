# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
An unknown lens grown from four stars outwards.

An assumed lens is right only near the stars that led to it. Fit and matching alternate: the
covariance P of the fitted parameters gives the pixel of each other catalogue star with the
covariance C = H P H^T + s^2, H the derivatives of its pixel and s the error of the spots. A spot
within the gate e^T C^-1 e < 9 is that star, unless the gate is so large that it holds a spot by
chance. So the match spreads over the image as the lens becomes known.

Were the four stars wrong, each of n other spots would be within r = 3 s of one of S stars of the
image with p = S pi r^2 / A, A the area over which the spots are spread. m matches of n have the
binomial tail P_1, their order of brightness P_3 of chance.py. The parameters
of the fit are worth six stars, which do not count. Both are combined as Fisher does.
"""

import numpy as np
from startracker_ros.core.attitude.triad import triad
from startracker_ros.core.camera.lens import Lens, project, rays, shows, undistorted
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import (
    matrix_from_quaternion, quaternion_from_matrix, sensor_directions)
from startracker_ros.photographs.chance import (
    binomial_tail, fisher_combined, order_probability)
from startracker_ros.photographs.lens_fit import fit_lens, linearised, stars_in_image

_STAGES = 12
_GATE_SQUARE = 9.0
# Probability of a random spot in the gate of a star at most.
_MOST_CHANCE = 0.15
_LEAST_ERROR_PX = 1.0
# After each stage at least one star more than before, of the first ones.
_FIRST_STARS, _GROWING = 5, 3
_MOST_ERROR = 0.02  # of the longest side: the four stars do not fit the lens
_PARAMETER_STARS = 6
_LEAST_FARTHEST_RAD = 1.0
# Beyond this angle no lens sees stars: images have a black margin.
_WIDEST_COS = np.cos(np.radians(97.0))


@compiled
def best_grown(start: Lens, free: np.ndarray, direction: np.ndarray, uv: np.ndarray,
               sigma_px: np.ndarray, spot: np.ndarray, star: np.ndarray, ratio: np.ndarray
               ) -> tuple[float, Lens, np.ndarray, np.ndarray]:
    """
    Return the most probable of the lenses that are grown from candidates.

    Spots spot (K, 4) of uv (N, 2) are taken for the stars star (K, 4) of direction (S, 3), and the
    focal length is that of start over ratio (K,). free (P,) is as in fit_lens(). Return the
    probability that it is chance, the lens, the attitude (4,) and the star (N,) of each spot.
    """
    best = 1.0, start, np.array([0.0, 0.0, 0.0, 1.0]), np.full(len(uv), -1)
    for k in range(len(spot)):
        assumed = Lens(start.width, start.height, start.fx / ratio[k], start.fy / ratio[k],
                       start.cx, start.cy, start.terms, start.distorted, start.equidistant,
                       start.farthest_rad)
        one = _grown(assumed, free, direction, uv, sigma_px, spot[k], star[k])
        if one[0] < best[0]:
            best = one
    return best


@compiled
def _grown(start: Lens, free: np.ndarray, direction: np.ndarray, uv: np.ndarray,
           sigma_px: np.ndarray, spot: np.ndarray, star: np.ndarray
           ) -> tuple[float, Lens, np.ndarray, np.ndarray]:
    """Return the lens that is grown from four spots (4,), as best_grown()."""
    sensor = rays(start.equidistant, undistorted(start, uv[spot]))
    q = quaternion_from_matrix(triad(sensor, direction[star], 0, 1))
    matched = np.full(len(uv), -1)
    matched[spot] = star
    lens, error_px = start, 0.0
    most_px = _MOST_ERROR * max(start.width, start.height)
    for stage in range(_STAGES):
        row = np.flatnonzero(matched >= 0)
        lens, q, covariance, error_px = fit_lens(
            lens, q, start, free, direction[matched[row]], uv[row], sigma_px[row])
        if not (error_px < most_px and lens.farthest_rad > _LEAST_FARTHEST_RAD):
            return 1.0, lens, q, matched
        after = gated(lens, q, covariance, max(error_px, _LEAST_ERROR_PX), direction, uv)
        if np.sum(after >= 0) < _FIRST_STARS + min(stage, _GROWING):
            return 1.0, lens, q, matched
        same = (after == matched).all()
        matched = after
        if same:
            break
    return _chance(lens, q, error_px, matched, direction, uv), lens, q, matched


@compiled
def gated(lens: Lens, q: np.ndarray, covariance: np.ndarray, error_px: float,
          direction: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """
    Return the star (N,) in whose gate each spot is, one to one, -1 for none.

    The lens has the covariance (P, P), the spots uv (N, 2) have the error error_px.
    """
    index, _ = stars_in_image(lens, q, direction)
    pixel, partial = linearised(lens, q, direction[index], len(covariance))
    sensor = sensor_directions(matrix_from_quaternion(q), direction[index])
    matched, best = np.full(len(uv), -1), np.full(len(uv), np.inf)
    largest = _MOST_CHANCE * lens.width * lens.height / (np.pi * len(uv))
    for k in range(len(index)):
        u, v = pixel[k, 0], pixel[k, 1]
        if sensor[k, 2] < _WIDEST_COS or not shows(lens, u, v):
            continue
        uu = vv = error_px ** 2
        cross = 0.0
        for i in range(len(covariance)):
            for j in range(len(covariance)):
                uu += partial[k, 0, i] * covariance[i, j] * partial[k, 0, j]
                cross += partial[k, 0, i] * covariance[i, j] * partial[k, 1, j]
                vv += partial[k, 1, i] * covariance[i, j] * partial[k, 1, j]
        determinant = uu * vv - cross * cross
        if not _GATE_SQUARE * np.sqrt(determinant) < largest:
            continue
        nearest, least = -1, _GATE_SQUARE
        for i in range(len(uv)):
            du, dv = uv[i, 0] - u, uv[i, 1] - v
            square = (vv * du * du - 2 * cross * du * dv + uu * dv * dv) / determinant
            if square < least:
                nearest, least = i, square
        if nearest >= 0 and least < best[nearest]:
            matched[nearest], best[nearest] = index[k], least
    return matched


@compiled
def _chance(lens: Lens, q: np.ndarray, error_px: float, matched: np.ndarray,
            direction: np.ndarray, uv: np.ndarray) -> float:
    """Return how probable it is that so many spots (N,) are matched by chance."""
    sensor = sensor_directions(matrix_from_quaternion(q), direction)
    pixel, seen = project(lens, sensor), 0
    for k in range(len(pixel)):
        seen += sensor[k, 2] >= _WIDEST_COS and shows(lens, pixel[k, 0], pixel[k, 1])
    # A disc of radius R has the mean square R^2 / 2.
    spread = np.mean((uv[:, 0] - np.mean(uv[:, 0])) ** 2 + (uv[:, 1] - np.mean(uv[:, 1])) ** 2)
    area = min(2 * np.pi * spread, float(lens.width * lens.height))
    radius_square = _GATE_SQUARE * max(error_px, _LEAST_ERROR_PX) ** 2
    p = min(seen * np.pi * radius_square / area, 1.0)
    m, n = int(np.sum(matched >= 0)) - _PARAMETER_STARS, len(uv) - _PARAMETER_STARS
    if m <= 0:
        return 1.0
    return fisher_combined(binomial_tail(m, n, p) * order_probability(matched, matched >= 0))
