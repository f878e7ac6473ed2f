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
from startracker_ros.core.compiled import compiled
from startracker_ros.core.track.residual_columns import strongest_pattern

LEAST_STARS = 8
STEPS = 12  # rows at which a frame may be torn
SIGNIFICANT = 36.0  # improvement of chi-square: 6 sigma
EXPLAINED = 0.5  # of chi-square, that the pattern explains,
LEAST_STEP_PX = 0.1  # if it is so large over the image
SLOPE_SIGNIFICANT, SLOPE_EXPLAINED = 20.0, 0.2  # of all frames together
SLOPE_DOUBTFUL = 9.0  # in the first frames, which tell little: one start in 370 waits
FIRST_FRAMES = 5
LEAST_SLOPE_PX = 0.05
MEMORY = 0.98  # of the slopes of the frames before
REACH_PX = 80.0  # of an image of a missed star
TOLERANCE_SHARE = 0.03  # of the shift
LEAST_SHIFTED, SHIFTED_SHARE = 4, 0.2  # of the stars, which are another image
MOST_COMPARED = 60  # missed stars: the time grows with their square
MOST_MISSED = 0.4  # of the stars that should be seen,
PLACED_SHARE = 0.7  # if so many centroids for each are no star
PRESENT_PX, PRESENT_SIGMAS = 0.5, 5.0  # distance of a centroid that is that of a star


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
        if len(stars.uv) < LEAST_STARS:
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
        if (found.best and gain > SIGNIFICANT * max(1.0, (chi2 - gain) / dof)
                and gain > EXPLAINED * chi2 and abs(shift_s) * speed_px_s > LEAST_STEP_PX):
            row = (found.edge + 0.5) * height
            return (f'the rows beyond {row:.0f} are {shift_s:.3g} s later than those before: '
                    'a torn frame')
        line_s = product / energy / height
        self._frames += 1
        significant = SLOPE_DOUBTFUL if self._frames <= FIRST_FRAMES else SLOPE_SIGNIFICANT
        if (product ** 2 / energy > significant
                and abs(line_s) * height * speed_px_s > LEAST_SLOPE_PX
                and product ** 2 / energy > SLOPE_EXPLAINED * excess):
            return (f'the residuals grow along the rows: line_time_us is off by '
                    f'{1e6 * line_s:.3g} us')
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
    if missed < LEAST_SHIFTED or len(free) < LEAST_SHIFTED:
        return ''
    every = -(-missed // MOST_COMPARED)
    compared = unseen[::every]
    count, shift = _largest_group(expected[compared], velocity[compared], free, present_px)
    if count >= LEAST_SHIFTED and every * count >= SHIFTED_SHARE * len(expected):
        return (f'{every * count} of {len(expected)} stars are seen {shift:.1f} px from where the '
                'others have them: a torn frame or a second image')
    if missed > MOST_MISSED * len(expected) and len(free) > PLACED_SHARE * missed:
        return (f'only {len(expected) - missed} of {len(expected)} stars that should be seen are, '
                f'and {len(free)} centroids are no star')
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
