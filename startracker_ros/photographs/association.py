# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Association of image stars with catalogue stars, for compiled searches.

As native/src/identify/association.h: the attitude and the focal length that fit.

Image stars are points in undistorted coordinates of the sensor frame (camera/lens.py), of the
nominal focal length; divided by the focal ratio they are those of the fitted one.
"""

import numpy as np
from startracker_ros.core.attitude.refinement import refine
from startracker_ros.core.attitude.triad import triad
from startracker_ros.core.camera.lens import plane_point, ray
from startracker_ros.core.catalog.sky_grid import nearest, SkyGrid
from startracker_ros.core.compiled import compiled, inlined


@compiled
def count_matched(matched: np.ndarray) -> int:
    """Return how many of the image stars (N,) have a catalogue star."""
    count = 0
    for star in matched:
        count += star >= 0
    return count


@compiled
def _equal(matched: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two associations (N,) are the same."""
    for i in range(len(matched)):
        if matched[i] != other[i]:
            return False
    return True


@inlined
def nearest_star(sky: SkyGrid, equidistant: bool, matrix: np.ndarray, a: float, b: float,
                 radius: float) -> tuple[int, float]:
    """Return the catalogue star nearest to a, b in the sensor frame, as nearest()."""
    x, y, z = ray(equidistant, a, b)
    return nearest(sky, matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
                   matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
                   matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z, radius)


@compiled
def _seen_at(equidistant: bool, matrix: np.ndarray, direction: np.ndarray, star: int
             ) -> tuple[float, float]:
    """Return where a star of direction (S, 3) is in undistorted coordinates."""
    # Scalars alone: a view of a row costs more than the arithmetic with it.
    x, y, z = direction[star, 0], direction[star, 1], direction[star, 2]
    return plane_point(equidistant, matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z,
                       matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z,
                       matrix[0, 2] * x + matrix[1, 2] * y + matrix[2, 2] * z)


@compiled
def _residual(equidistant: bool, matrix: np.ndarray, direction: np.ndarray, star: int, a: float,
              b: float) -> float:
    """Return the distance of a star of direction (S, 3) from a, b in the sensor frame."""
    star_a, star_b = _seen_at(equidistant, matrix, direction, star)
    da, db = star_a - a, star_b - b
    return np.sqrt(da * da + db * db)


@compiled
def _associate(sky: SkyGrid, equidistant: bool, matrix: np.ndarray, seen: np.ndarray,
               ratio: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the catalogue star (N,) nearest to each image star and its residual (N,).

    One to one: of several image stars at one star the nearest is associated. -1 and NaN beyond
    the radius.
    """
    count = len(seen)
    matched = np.full(count, -1)
    residual = np.full(count, np.nan)
    for i in range(count):
        a, b = seen[i, 0] / ratio, seen[i, 1] / ratio
        star, _ = nearest_star(sky, equidistant, matrix, a, b, radius)
        if star < 0:
            continue
        distance = _residual(equidistant, matrix, sky.direction, star, a, b)
        # A star that cannot be seen has the residual NaN.
        if not distance <= radius:
            continue
        for other in range(i):
            if matched[other] == star:
                if residual[other] <= distance:
                    star = -1
                else:
                    matched[other], residual[other] = -1, np.nan
                break
        if star >= 0:
            matched[i], residual[i] = star, distance
    return matched, residual


@compiled
def _matched_directions(equidistant: bool, seen: np.ndarray, sigma: np.ndarray, ratio: float,
                        matched: np.ndarray, direction: np.ndarray
                        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sensor (M, 3) and ICRF (M, 3) directions and weights (M,) of the matched stars."""
    count = count_matched(matched)
    sensor, icrf, weight = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    row = 0
    for i in range(len(matched)):
        if matched[i] < 0:
            continue
        sensor[row, 0], sensor[row, 1], sensor[row, 2] = ray(
            equidistant, seen[i, 0] / ratio, seen[i, 1] / ratio)
        for k in range(3):
            icrf[row, k] = direction[matched[i], k]
        weight[row] = 1 / sigma[i] ** 2
        row += 1
    return sensor, icrf, weight


@compiled
def _farthest(vectors: np.ndarray) -> int:
    """Return the vector (N, 3) that is farthest from the first."""
    farthest, most = 0, -1.0
    for i in range(1, len(vectors)):
        chord2 = ((vectors[i, 0] - vectors[0, 0]) ** 2 + (vectors[i, 1] - vectors[0, 1]) ** 2
                  + (vectors[i, 2] - vectors[0, 2]) ** 2)
        if chord2 > most:
            farthest, most = i, chord2
    return farthest


@compiled
def _focal_ratio(equidistant: bool, matrix: np.ndarray, sensor: np.ndarray, icrf: np.ndarray
                ) -> float:
    """
    Return the focal length that fits over the one of the sensor directions (M, 3).

    With p_i the seen and q_i the predicted undistorted coordinates, and p, q their means,
    it is the least-squares scale sum (p_i - p) . (q_i - q) / sum |q_i - q|^2. About the means and
    not about the axis: else stars on one side of the image would hide a wrong scale in a wrong
    attitude.
    """
    count = len(sensor)
    q = np.empty((count, 2))
    p = np.empty((count, 2))
    p_mean, q_mean = np.zeros(2), np.zeros(2)
    for i in range(count):
        q[i, 0], q[i, 1] = _seen_at(equidistant, matrix, icrf, i)
        p[i, 0], p[i, 1] = plane_point(equidistant, sensor[i, 0], sensor[i, 1], sensor[i, 2])
        for k in range(2):
            p_mean[k] += p[i, k] / count
            q_mean[k] += q[i, k] / count
    pq = qq = 0.0
    for i in range(count):
        for k in range(2):
            dq = q[i, k] - q_mean[k]
            pq += (p[i, k] - p_mean[k]) * dq
            qq += dq * dq
    return pq / qq


@compiled
def _scatter(seen: np.ndarray, matched: np.ndarray) -> float:
    """Return sqrt(sum |p_i - p|^2) of the matched stars p_i, p their mean."""
    count = 0
    x = y = xx = yy = 0.0
    for i in range(len(seen)):
        if matched[i] >= 0:
            count += 1
            x += seen[i, 0]
            y += seen[i, 1]
            xx += seen[i, 0] ** 2
            yy += seen[i, 1] ** 2
    return np.sqrt(max(xx + yy - (x * x + y * y) / count, 0.0))


@compiled
def align(sky: SkyGrid, equidistant: bool, seen: np.ndarray, sigma: np.ndarray,
          base: np.ndarray, star: np.ndarray, radius: float, scale_error: float
          ) -> tuple[bool, float, np.ndarray, np.ndarray, np.ndarray]:
    """
    Associate all image stars when those of base (B,) are the catalogue stars star (B,).

    seen (N, 2) are the image stars, sigma (N,) their errors; they and radius are in undistorted
    coordinates. Return whether four stars or more agree with an attitude and a scale within
    scale_error, the focal ratio, the association and residuals as _associate() and the matrix
    (3, 3) to ICRF.
    """
    matched = np.full(len(seen), -1)
    for i in range(len(base)):
        matched[base[i]] = star[i]
    residual = np.full(len(seen), np.nan)
    matrix = np.eye(3)
    ratio = fitted = 1.0
    # First the scale of the base alone: where that is off, so is the attitude. The first radius
    # then allows for the attitude that close stars extrapolate; used twice, because the stars
    # found first lead to those at the far side of the image.
    for attempt in range(5):
        before = matched
        sensor, icrf, weight = _matched_directions(equidistant, seen, sigma, ratio, matched,
                                                   sky.direction)
        if attempt == 0:
            matrix = triad(sensor, icrf, 0, _farthest(sensor))
        # What one step leaves is little beside the radius, and more steps follow.
        if not refine(matrix, sensor, icrf, weight, 1)[1] > 0:
            return False, ratio, matched, residual, matrix
        fitted = ratio * _focal_ratio(equidistant, matrix, sensor, icrf)
        # Close stars may determine the scale less well than it was known before.
        ratio = min(max(fitted, 1 - scale_error), 1 + scale_error)
        if attempt == 0:
            continue
        matched, residual = _associate(sky, equidistant, matrix, seen, ratio,
                                       3 * radius if attempt < 3 else radius)
        if count_matched(matched) < 4:
            return False, ratio, matched, residual, matrix
        if attempt > 1 and _equal(matched, before):
            # The same association with the focal length that it has led to.
            sensor, icrf, weight = _matched_directions(equidistant, seen, sigma, ratio,
                                                       matched, sky.direction)
            refine(matrix, sensor, icrf, weight, 1)
            # A narrower radius would leave it as it is.
            if _update(sky.direction, equidistant, matrix, seen, ratio, matched,
                       residual) <= radius:
                break
    agrees = abs(fitted - 1) <= scale_error + radius / _scatter(seen, matched)
    return agrees, ratio, matched, residual, matrix


@compiled
def _update(direction: np.ndarray, equidistant: bool, matrix: np.ndarray, seen: np.ndarray,
            ratio: float, matched: np.ndarray, residual: np.ndarray) -> float:
    """Put the residuals of an association into residual (N,); return the largest."""
    largest = 0.0
    for i in range(len(matched)):
        if matched[i] >= 0:
            residual[i] = _residual(equidistant, matrix, direction, matched[i],
                                    seen[i, 0] / ratio, seen[i, 1] / ratio)
            largest = max(largest, residual[i])
    return largest
