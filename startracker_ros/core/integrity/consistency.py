# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Whether all of an image shows one attitude.

A torn frame holds rows of the frame before, a rolling shutter whose line time is wrong shows each
row at another time: part of the stars support one attitude, part another. Both leave a pattern:
residuals along the motion of the stars that are a step, or grow, from row to row. Where the parts
are further apart than the gates, stars are missed whose images lie all by the same shift, or by
the same time, from where they should be.

The residuals r of the stars, whitened, are fitted with columns that are no fault of the rows: a
rotation, the focal length and a radial distortion. A column c = f g(v), f the velocity of a star
and g(v) a step or a line, improves chi-square by (c' r)^2 / (c' c), both after those columns.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.compiled import compiled, reordered
from startracker_ros.core.integrity.checks import (
    FIRST_LINE_TIME, LINE_TIME, MISSING_STARS, SECOND_IMAGE, TORN_FRAME)

STEPS = 12  # rows at which a frame may be torn
MEMORY = 0.98  # of the slopes of the frames before
REACH_PX = SECOND_IMAGE.limits['reach_px']
TOLERANCE_SHARE = 0.03  # of the shift
MOST_COMPARED = 60  # missed stars: the time grows with their square


class Residuals(NamedTuple):
    """
    The detected stars of a frame: uv (K, 2), residual (K, 2) px, error (K, 2, 2) px^2.

    flow (K, 2, 3) is the image jacobian, velocity (K, 2) that in px/s.
    """

    uv: np.ndarray
    residual: np.ndarray
    error: np.ndarray
    flow: np.ndarray
    velocity: np.ndarray


class RowPattern:
    """Looks for patterns along the rows; remembers slopes, which are the same in every frame."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._axis_px = np.array([camera.cx, camera.cy])
        # Product and energy of the line, and the excess of chi-square.
        self._slope: tuple[float, ...] = 0.0, 0.0, 0.0
        self._frames = 0

    def find(self, stars: Residuals) -> str:
        """Return which pattern the residuals have, in words; empty for none."""
        if len(stars.uv) < TORN_FRAME.limits['stars']:
            return ''
        height = self._camera.height
        found = strongest_pattern(*stars, self._axis_px, height, STEPS)
        chi2, dof = found.chi2, max(2 * len(stars.uv) - 6, 1)
        speed_px_s = math.sqrt(2 * found.mean_square)
        gain, scatter = found.product ** 2 / found.energy, max(
            1.0, (chi2 - found.line_product ** 2 / found.line_energy) / dof)
        product, energy, excess = self._slope = tuple(
            MEMORY * before + value / scatter for before, value in zip(
                self._slope, (found.line_product, found.line_energy, chi2 - dof)))
        shift_s = found.product / found.energy
        if (found.best and gain > TORN_FRAME.threshold * max(1.0, (chi2 - gain) / dof)
                and gain > TORN_FRAME.limits['explained_share'] * chi2
                and abs(shift_s) * speed_px_s > TORN_FRAME.limits['step_px']):
            return TORN_FRAME.diagnostic.format(
                row=(found.edge + 0.5) * height, shift_s=shift_s)
        line_s = product / energy / height
        self._frames += 1
        check = FIRST_LINE_TIME if self._frames <= FIRST_LINE_TIME.frames else LINE_TIME
        if (product ** 2 / energy > check.threshold
                and abs(line_s) * height * speed_px_s > LINE_TIME.limits['slope_px']
                and product ** 2 / energy > LINE_TIME.limits['explained_share'] * excess):
            return check.diagnostic.format(line_us=1e6 * line_s)
        return ''


def expected_stars(expected: np.ndarray, velocity: np.ndarray, uv: np.ndarray,
                   present_px: float) -> str:
    """
    Return what speaks against an attitude among the stars that should be seen; empty if nothing.

    expected (N, 2) px are these stars by the attitude, velocity (N, 2) px/s, uv (M, 2) px all
    centroids. A star is seen by a centroid within present_px. Stars that are hidden are no
    contradiction; stars that are elsewhere are.
    """
    unseen, left = _alone(expected, uv, present_px)
    missed, free = len(unseen), uv[left]
    shifted, missing = SECOND_IMAGE.limits, MISSING_STARS.limits
    if min(missed, len(free)) < shifted['stars']:
        return ''
    every = -(-missed // MOST_COMPARED)
    compared = unseen[::every]
    count, shift = _largest_group(expected[compared], velocity[compared], free, present_px)
    if count >= shifted['stars'] and every * count >= shifted['share'] * len(expected):
        return SECOND_IMAGE.diagnostic.format(
            count=every * count, stars=len(expected), shift_px=shift)
    if (missed > missing['missed_share'] * len(expected)
            and len(free) > missing['placed_share'] * missed):
        return MISSING_STARS.diagnostic.format(
            seen=len(expected) - missed, stars=len(expected), free=len(free))
    return ''


@compiled
def _alone(points: np.ndarray, others: np.ndarray, distance: float
           ) -> tuple[np.ndarray, np.ndarray]:
    """Return which points (N, 2) have none of the others (M, 2) so near, and which others."""
    near, taken = np.zeros(len(points), np.bool_), np.zeros(len(others), np.bool_)
    for i in range(len(points)):
        for j in range(len(others)):
            if ((points[i, 0] - others[j, 0]) ** 2 + (points[i, 1] - others[j, 1]) ** 2
                    < distance * distance):
                near[i] = taken[j] = True
    return np.flatnonzero(~near), np.flatnonzero(~taken)


@compiled
def _largest_group(expected: np.ndarray, velocity: np.ndarray, free: np.ndarray,
                   present_px: float) -> tuple[int, float]:
    """Return the most stars with a centroid at one shift or one time away, and the shift."""
    best, best_px = 0, 0.0
    for i in range(len(expected)):
        speed2 = velocity[i, 0] ** 2 + velocity[i, 1] ** 2
        for j in range(len(free)):
            du, dv = free[j, 0] - expected[i, 0], free[j, 1] - expected[i, 1]
            length = np.hypot(du, dv)
            if length > REACH_PX:
                continue
            tolerance = 0.6 * present_px + TOLERANCE_SHARE * length
            for by_time in (False, True):
                time_s = (du * velocity[i, 0] + dv * velocity[i, 1]) / max(speed2, 1e-12)
                if by_time and np.hypot(du - time_s * velocity[i, 0],
                                        dv - time_s * velocity[i, 1]) > tolerance:
                    continue
                count = 0
                for k in range(len(expected)):
                    u, v = expected[k, 0] + du, expected[k, 1] + dv
                    if by_time:
                        u = expected[k, 0] + time_s * velocity[k, 0]
                        v = expected[k, 1] + time_s * velocity[k, 1]
                    count += _has_near(free, u, v, tolerance)
                if count > best:
                    best, best_px = count, length
    return best, best_px


@compiled
def _has_near(points: np.ndarray, u: float, v: float, distance: float) -> bool:
    """Return whether one of points (M, 2) is so near to u, v."""
    for j in range(len(points)):
        if (points[j, 0] - u) ** 2 + (points[j, 1] - v) ** 2 < distance * distance:
            return True
    return False


# --- whitened residuals fitted with columns, compiled ---
#
# A residual r of a star with covariance R = L L^T is whitened as L^-1 r. Columns that are no error
# of the rows or of the lens (a rotation of all stars, a scale) are taken out by an orthonormal
# basis Q: x <- x - Q Q^T x.

_ROTATION, _ROTATION_AND_RADIAL = 3, 5
_DEPENDENT = 1e-9
"""A column that keeps less of its length beside the columns before is a sum of them."""

_LEAST_ENERGY = 1e-12
"""Of a column that is a pattern: that of stars that do not move is zero."""


class RowFit(NamedTuple):
    """
    Residuals r against columns c of P patterns along the rows, first a line, then steps.

    product (P,) is c^T r, energy (P,) c^T c, chi2 r^T r, and edges (P - 1,) where the steps are.
    """

    product: np.ndarray
    energy: np.ndarray
    chi2: float
    edges: np.ndarray


class StrongestPattern(NamedTuple):
    """
    The pattern along the rows that explains most of chi2, and the line, pattern 0.

    best is its number, product and energy are those of RowFit, edge where it steps, NaN for the
    line; mean_square is that of the velocity components, px^2/s^2.
    """

    best: int
    product: float
    energy: float
    edge: float
    line_product: float
    line_energy: float
    chi2: float
    mean_square: float


class LensSums(NamedTuple):
    """
    Residuals without their rotation.

    outwards and square are r^T W d and d^T W d of the distances d from the axis, W = 1 / sigma^2.
    residual and away (K, 2) are r and d, left (K,) the share that r holds of the variance of
    errors that are as large for all stars, and variance (K,) that of the centroids, px^2.
    """

    outwards: float
    square: float
    residual: np.ndarray
    away: np.ndarray
    left: np.ndarray
    variance: np.ndarray


@compiled
def fit_rows(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
             velocity: np.ndarray, axis: np.ndarray, height: int, steps: int) -> RowFit:
    """
    Fit residuals (K, 2) of error (K, 2, 2) with velocity (K, 2) g(v), g a line or one of steps.

    Columns of rotation, flow (K, 2, 3), of scale and of radial distortion about axis (2,) are
    taken out before.
    """
    count, first = len(uv), _ROTATION_AND_RADIAL + 1
    rows = (uv[:, 1] - (height - 1) / 2) / height
    inner = np.sort(rows)[3:-3]
    edges = np.empty(steps)
    for k in range(steps):
        edges[k] = inner[k * (len(inner) - 1) // (steps - 1)]
    columns = np.empty((first + 1 + steps, 2 * count))
    for star in range(count):
        du, dv = (uv[star, 0] - axis[0]) / height, (uv[star, 1] - axis[1]) / height
        square = du * du + dv * dv
        R = error[star]
        for k in range(_ROTATION):
            _whiten(columns[k], star, R, flow[star, 0, k], flow[star, 1, k])
        _whiten(columns[3], star, R, du, dv)
        _whiten(columns[4], star, R, du * square, dv * square)
        _whiten(columns[5], star, R, residual[star, 0], residual[star, 1])
        f, g = velocity[star]
        _whiten(columns[first], star, R, f * rows[star], g * rows[star])
        for k in range(steps):
            side = 0.5 if rows[star] > edges[k] else -0.5
            _whiten(columns[first + 1 + k], star, R, f * side, g * side)
    _take_out(columns, _ROTATION_AND_RADIAL)
    r = columns[first - 1]
    product, energy = np.empty(steps + 1), np.empty(steps + 1)
    for k in range(steps + 1):
        product[k] = _inner(columns[first + k], r)
        energy[k] = _inner(columns[first + k], columns[first + k])
    return RowFit(product, energy, _inner(r, r), edges)


@compiled
def strongest_pattern(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
                      velocity: np.ndarray, axis: np.ndarray, height: int, steps: int
                      ) -> StrongestPattern:
    """Return the pattern of fit_rows() with the largest (c^T r)^2 / c^T c."""
    fit = fit_rows(uv, residual, error, flow, velocity, axis, height, steps)
    energy = np.maximum(fit.energy, _LEAST_ENERGY)
    best = int(np.argmax(fit.product ** 2 / energy))
    return StrongestPattern(
        best, fit.product[best], energy[best], fit.edges[best - 1] if best else np.nan,
        fit.product[0], energy[0], fit.chi2, np.mean(velocity ** 2))


@compiled
def lens_sums(uv: np.ndarray, residual: np.ndarray, error: np.ndarray, flow: np.ndarray,
              axis: np.ndarray) -> LensSums:
    """Take the rotation out of residuals (K, 2) and of the distances from axis (2,)."""
    count = len(uv)
    columns, variance = np.empty((_ROTATION + 2, 2 * count)), np.empty(count)
    for star in range(count):
        variance[star] = (error[star, 0, 0] + error[star, 1, 1]) / 2
        root = 1 / math.sqrt(variance[star])
        for i in range(2):
            for k in range(_ROTATION):
                columns[k, 2 * star + i] = flow[star, i, k] * root
            columns[_ROTATION, 2 * star + i] = residual[star, i] * root
            columns[_ROTATION + 1, 2 * star + i] = (uv[star, i] - axis[i]) * root
    _take_out(columns, _ROTATION)
    white, outward = columns[_ROTATION], columns[_ROTATION + 1]
    found = LensSums(_inner(white, outward), _inner(outward, outward), np.empty((count, 2)),
                     np.empty((count, 2)), np.empty(count), variance)
    # Diagonal of A A^T with A = I - s Q Q^T / s and the standard deviations s.
    inner = np.zeros((_ROTATION, _ROTATION))
    for row in range(2 * count):
        for k in range(_ROTATION):
            for m in range(_ROTATION):
                inner[k, m] += columns[k, row] * columns[m, row] / variance[row // 2]
    for star in range(count):
        sigma = math.sqrt(variance[star])
        found.left[star] = 1.0
        for i in range(2):
            row = 2 * star + i
            found.residual[star, i], found.away[star, i] = white[row] * sigma, outward[row] * sigma
            for k in range(_ROTATION):
                found.left[star] -= columns[k, row] ** 2
                for m in range(_ROTATION):
                    found.left[star] += (columns[k, row] * inner[k, m] * columns[m, row]
                                         * variance[star] / 2)
    return found


@reordered
def _inner(a: np.ndarray, b: np.ndarray) -> float:
    """Return a^T b; of so few rows in less time than the call of a library."""
    total = 0.0
    for row in range(len(a)):
        total += a[row] * b[row]
    return total


@compiled
def _whiten(column: np.ndarray, star: int, R: np.ndarray, x: float, y: float) -> None:
    """Set two rows of a column to L^-1 (x, y) with R = L L^T."""
    a = math.sqrt(R[0, 0])
    b = R[0, 1] / a
    column[2 * star] = x / a
    column[2 * star + 1] = (y - b * x / a) / math.sqrt(R[1, 1] - b * b)


@compiled
def _take_out(columns: np.ndarray, count: int) -> None:
    """Make the first columns (C, N) orthonormal, or 0 if dependent, and take them out of all."""
    for k in range(len(columns)):
        before = math.sqrt(_inner(columns[k], columns[k]))
        # Twice: once leaves rounding errors of what was taken out.
        for _ in range(2):
            for m in range(min(k, count)):
                along = _inner(columns[m], columns[k])
                for row in range(columns.shape[1]):
                    columns[k, row] -= along * columns[m, row]
        if k < count:
            left = math.sqrt(_inner(columns[k], columns[k]))
            columns[k] *= 1 / left if left > _DEPENDENT * before else 0.0
