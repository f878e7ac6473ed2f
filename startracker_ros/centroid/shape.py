"""Does a fitted spot look like a star: width and elongation."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.centroid.gaussian_fit import Fit
from startracker_ros.centroid.normal_equations import MAX_COLUMNS
from startracker_ros.centroid.psf import FLUX, profile, SIGMA, U, V
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled, reordered

WIDTH_RATIO = 2.0  # the other hypotheses: half as wide, twice as wide
MARGIN = 9.0  # of chi2, by which another width must be better
MAX_ELONGATION = 0.4
(LIGHT, LIGHT_Y, LIGHT_YY, SIZE, SIZE_YY, ERROR, ERROR_YY, ERROR_YYYY,
 SUMS) = range(0, 9 * MAX_COLUMNS, MAX_COLUMNS)
"""Where the sums down the columns of a window begin, for its moments."""
LONE_PIXEL = 0.3  # less light than this share of a pixel in the eight around it


class Shape(NamedTuple):
    """
    What is wrong with each of K spots, all (K,) bool.

    narrow: hot pixels and cosmic hits; wide: spots that no star makes; elongated: streaks.
    """

    narrow: np.ndarray
    wide: np.ndarray
    elongated: np.ndarray


@compiled
def lone_pixels(data: np.ndarray) -> np.ndarray:
    """Return whether (K,) the middle pixel of windows (K, n, n) has hardly any light around it."""
    middle, lone = data.shape[1] // 2, np.empty(len(data), np.bool_)
    for i in range(len(data)):
        around = -data[i, middle, middle]
        for y in range(middle - 1, middle + 2):
            for x in range(middle - 1, middle + 2):
                around += data[i, y, x]
        lone[i] = around <= LONE_PIXEL * data[i, middle, middle]
    return lone


def judge_shape(fit: Fit, windows: Windows) -> Shape:
    """
    Return the shapes of all spots.

    Spots chained to an elongated one are part of it, as the fit of neighbours in turns cuts
    a long streak into round pieces.
    """
    return Shape(*_judge(fit, windows))


@compiled
def streaks(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for elongated spots, each looked at alone."""
    streak, filled = np.empty(len(fit.parameters), np.bool_), windows.data.shape[2]
    sums, across = np.empty(SUMS, np.float32), np.empty((2, filled), np.float32)
    for i in range(len(streak)):
        streak[i] = _elongated(fit, windows, i, across, sums)
    return streak


@compiled
def _judge(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stars, count, filled = windows.data.shape
    narrow, wide = np.empty(stars, np.bool_), np.empty(stars, np.bool_)
    streak = streaks(fit, windows)
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    work = np.empty(count * filled, np.float32)
    for i in range(stars):
        limit = fit.chi2[i] - MARGIN
        narrow[i] = _chi2_of_width(fit, windows, i, 1 / WIDTH_RATIO, columns, rows, work) < limit
        wide[i] = _chi2_of_width(fit, windows, i, WIDTH_RATIO, columns, rows, work) < limit
    grown = bool(streak.any())
    while grown:
        grown = False
        for i in range(stars):
            for k in range(windows.first[i], windows.first[i + 1]):
                if streak[windows.sources[k]] and not streak[i]:
                    streak[i] = grown = True
    return narrow, wide, streak


@reordered
def _chi2_of_width(fit: Fit, windows: Windows, i: int, ratio: float, columns: np.ndarray,
                   rows: np.ndarray, work: np.ndarray) -> np.floating:
    """
    Return chi2 of a star `ratio` times as wide at the same place, flux and level free.

    columns (3, m), rows (3, n) and work (n m,) are filled.
    """
    star, filled = fit.parameters[i], columns.shape[1]
    profile(star[U], star[SIGMA] * ratio, windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA] * ratio, windows.corner[i, 1], rows)
    for y in range(rows.shape[1]):
        for x in range(filled):
            work[y * filled + x] = rows[0, y] * columns[0, x]
    weight, own = fit.weight[i].ravel(), fit.own[i].ravel()
    total = s = d = ss = sd = dd = np.float32(0)
    for k in range(len(work)):
        ws, wd = weight[k] * work[k], weight[k] * own[k]
        total += weight[k]
        s += ws
        d += wd
        ss += ws * work[k]
        sd += ws * own[k]
        dd += wd * own[k]
    whole, of_star, of_own = float(total), float(s), float(d)
    return (dd - of_own * of_own / whole - (sd - of_star * of_own / whole) ** 2
            / (ss - of_star * of_star / whole))


@reordered
def _elongated(fit: Fit, windows: Windows, i: int, across: np.ndarray, sums: np.ndarray) -> bool:
    """
    Return whether spot i is a streak, by second moments under a Gaussian twice a star's width.

    The elongation is (a - b) / (a + b) of the moments a, b along the axes of the spot; it must
    exceed MAX_ELONGATION by three times its error. across (2, m) and sums are filled.
    """
    star, per_width = fit.parameters[i], 1 / (8 * fit.parameters[i, SIGMA] ** 2)
    for m in range(across.shape[1]):
        x = windows.corner[i, 0] + m - star[U]
        across[0, m], across[1, m] = x, math.exp(-x * x * per_width)
    sums[:] = 0
    none = np.float32(0)
    for k in range(windows.data.shape[1]):
        down = windows.corner[i, 1] + k - star[V]
        share = np.float32(math.exp(-down * down * per_width))
        y = np.float32(down)
        yy = y * y
        for m in range(across.shape[1]):
            weight, own, light = fit.weight[i, k, m], fit.own[i, k, m], fit.light[i, k, m]
            used = share if weight > none else none
            variance = used * used / weight if weight > none else none
            size = used * (own if own > light else light)
            own *= used
            sums[LIGHT + m] += own
            sums[LIGHT_Y + m] += own * y
            sums[LIGHT_YY + m] += own * yy
            sums[SIZE + m] += size
            sums[SIZE_YY + m] += size * yy
            sums[ERROR + m] += variance
            sums[ERROR_YY + m] += variance * yy
            sums[ERROR_YYYY + m] += variance * yy * yy
    straight = oblique = size = error = none
    for m in range(across.shape[1]):
        x, share = across[0, m], across[1, m]
        xx = x * x
        straight += share * (xx * sums[LIGHT + m] - sums[LIGHT_YY + m])
        oblique += share * x * sums[LIGHT_Y + m]
        size += share * (xx * sums[SIZE + m] + sums[SIZE_YY + m])
        error += share * share * (xx * (xx * sums[ERROR + m] + sums[ERROR_YY + m]
                                        + sums[ERROR_YY + m]) + sums[ERROR_YYYY + m])
    return (math.hypot(straight, np.float32(2) * oblique)
            > MAX_ELONGATION * size + 3 * math.sqrt(error / 2))


@compiled
def repeated(fit: Fit, windows: Windows, apart_px: float) -> np.ndarray:
    """Return True (K,) for the fainter of two fits that are closer than apart_px."""
    twice = np.zeros(len(fit.parameters), np.bool_)
    for i in range(len(twice)):
        for k in range(windows.first[i], windows.first[i + 1]):
            star, other = fit.parameters[i], fit.parameters[windows.sources[k]]
            if math.hypot(star[U] - other[U], star[V] - other[V]) < apart_px:
                twice[i] |= star[FLUX] < other[FLUX]
    return twice
