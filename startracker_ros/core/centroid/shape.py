# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether a fitted spot has the shape of a star: size and elongation."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.gaussian_fit import Fit
from startracker_ros.core.centroid.normal_equations import MAX_COLUMNS
from startracker_ros.core.centroid.psf import profile, SHARE, SIGMA, U, V
from startracker_ros.core.centroid.windows import Windows
from startracker_ros.core.compiled import compiled, reordered

WIDTH_RATIO = 2.0  # of the alternative hypotheses: half as wide, twice as wide
MARGIN = 9.0  # of chi-square, by which another sigma must be better
MAX_ELONGATION = 0.4
COMMON_ELONGATION = 0.08  # of all spots together,
COMMON_SIGMAS = 4.0  # if it is so significant
LONE_PIXEL = 0.3  # less flux than this share of a pixel in the eight around it
# Where the sums over y begin, flat with constant steps as in normal_equations.py.
(M_0, M_Y, M_YY, SIZE_0, SIZE_YY, VAR_0, VAR_YY, VAR_YYYY,
 _END) = range(0, 9 * MAX_COLUMNS, MAX_COLUMNS)


class Shape(NamedTuple):
    """
    Which of K spots are no stars, all (K,) bool.

    narrow: hot pixels and cosmic-ray hits; wide: blurred spots; elongated: streaks. smeared is
    whether the spots together are longer in one direction, though each alone may pass as round.
    """

    narrow: np.ndarray
    wide: np.ndarray
    elongated: np.ndarray
    smeared: bool


@compiled
def lone_pixel(data: np.ndarray) -> bool:
    """Return whether the middle pixel of a window (n, n) has hardly any flux around it."""
    middle = data.shape[0] // 2
    around = -data[middle, middle]
    for y in range(middle - 1, middle + 2):
        for x in range(middle - 1, middle + 2):
            around += data[y, x]
    return around <= LONE_PIXEL * data[middle, middle]


@compiled
def streaks(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for spots that are elongated themselves."""
    return _elongated(_moments(fit, windows))


@compiled
def _moments(fit: Fit, windows: Windows) -> np.ndarray:
    """Return the moments (K, 4) of all spots: M_xx - M_yy, 2 M_xy, size and variance."""
    moments, filled = np.empty((len(fit.parameters), 4)), windows.data.shape[2]
    sums, across = np.empty(_END, np.float32), np.empty((2, filled), np.float32)
    for i in range(len(moments)):
        moments[i, 0], moments[i, 1], moments[i, 2], moments[i, 3] = _moments_of(
            fit, windows, i, across, sums)
    return moments


@compiled
def _elongated(moments: np.ndarray) -> np.ndarray:
    """
    Return which spots (K,) are streaks, by their moments (K, 4).

    The elongation must exceed MAX_ELONGATION by three standard deviations of the numerator.
    """
    streak = np.empty(len(moments), np.bool_)
    for i in range(len(moments)):
        streak[i] = (math.hypot(moments[i, 0], moments[i, 1])
                     > MAX_ELONGATION * moments[i, 2] + 3 * math.sqrt(moments[i, 3]))
    return streak


@compiled
def _smeared(moments: np.ndarray, chosen: np.ndarray) -> bool:
    """
    Return whether the chosen spots (K,) are elongated together, by their moments (K, 4).

    Round spots have numerators of mean zero: a weighted sum of all exceeds COMMON_SIGMAS
    standard deviations, and COMMON_ELONGATION of the summed sizes, only if they are streaks.
    """
    straight = oblique = size = variance = 0.0
    for i in range(len(moments)):
        if chosen[i] and moments[i, 2] > 0:
            weight = 1 / (moments[i, 2] + math.sqrt(moments[i, 3]))
            straight += weight * moments[i, 0]
            oblique += weight * moments[i, 1]
            size += weight * moments[i, 2]
            variance += weight * weight * moments[i, 3]
    length = math.hypot(straight, oblique)
    return length > COMMON_SIGMAS * math.sqrt(variance) and length > COMMON_ELONGATION * size


@compiled
def classify_shapes(fit: Fit, windows: Windows) -> Shape:
    """
    Return the shapes of all spots.

    Spots connected to an elongated one by neighbours are part of it: the fit of neighbours in
    turns cuts a long streak into round pieces.
    """
    narrow, wide = _test_sigmas(fit, windows)
    moments = _moments(fit, windows)
    return Shape(narrow, wide, _grow(_elongated(moments), windows), _smeared(moments, ~narrow))


@compiled
def _grow(streak: np.ndarray, windows: Windows) -> np.ndarray:
    """Return streak (K,) with all spots that neighbours connect to one."""
    grown = bool(streak.any())
    while grown:
        grown = False
        for i in range(len(streak)):
            for k in range(windows.first[i], windows.first[i + 1]):
                if streak[windows.sources[k]] and not streak[i]:
                    streak[i] = grown = True
    return streak


@compiled
def _test_sigmas(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Return narrow and wide (K,): another sigma has a chi-square better by MARGIN."""
    stars, count, filled = windows.data.shape
    narrow, wide = np.empty(stars, np.bool_), np.empty(stars, np.bool_)
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    work = np.empty(count * filled, np.float32)
    for i in range(stars):
        limit = fit.chi2[i] - MARGIN
        narrow[i] = _chi2_of_width(fit, windows, i, 1 / WIDTH_RATIO, columns, rows, work) < limit
        wide[i] = _chi2_of_width(fit, windows, i, WIDTH_RATIO, columns, rows, work) < limit
    return narrow, wide


@reordered
def _chi2_of_width(fit: Fit, windows: Windows, i: int, ratio: float, columns: np.ndarray,
                   rows: np.ndarray, work: np.ndarray) -> np.floating:
    """
    Return chi-square of a star `ratio` times as wide at the same position, flux and level free.

    With the profile s = a(x) d(y), the data D and sums over pixels with weights w, it is

        sum w D^2 - (sum w D)^2 / W - (sum w s D - sum w s sum w D / W)^2
                                      / (sum w s^2 - (sum w s)^2 / W),  W = sum w

    columns (3, m), rows (3, n) and work (n m,) are work arrays.
    """
    star, filled = fit.parameters[i], columns.shape[1]
    profile(star[U], star[SIGMA] * ratio, windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA] * ratio, windows.corner[i, 1], rows)
    for y in range(rows.shape[1]):
        for x in range(filled):
            work[y * filled + x] = rows[SHARE, y] * columns[SHARE, x]
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
    sum_w, sum_s, sum_d = float(total), float(s), float(d)
    return (dd - sum_d * sum_d / sum_w - (sd - sum_s * sum_d / sum_w) ** 2
            / (ss - sum_s * sum_s / sum_w))


@reordered
def _moments_of(fit: Fit, windows: Windows, i: int, across: np.ndarray, sums: np.ndarray
                ) -> tuple[float, float, float, float]:
    """
    Return the second moments of spot i, their size and the variance of the first two.

    With weights g(x) g(y), a Gaussian twice as wide as a star, flux D and coordinates from the
    position of the star, the elongation (a - b) / (a + b) of the moments a, b along the axes
    of the spot is

        sqrt((M_xx - M_yy)^2 + (2 M_xy)^2) / (M_xx + M_yy),  M_xy = sum g(x) g(y) D x y

    M_xx + M_yy counts a pixel with no less than the model's flux. across (2, m) and sums are
    work arrays.
    """
    star, per_width = fit.parameters[i], 1 / (8 * fit.parameters[i, SIGMA] ** 2)
    for m in range(across.shape[1]):
        x = windows.corner[i, 0] + m - star[U]
        across[0, m], across[1, m] = x, math.exp(-x * x * per_width)
    _set_moments(fit, windows, i, per_width, sums)
    straight = oblique = size = variance = np.float32(0)
    for m in range(across.shape[1]):
        x, g = across[0, m], across[1, m]
        xx = x * x
        straight += g * (xx * sums[M_0 + m] - sums[M_YY + m])
        oblique += g * x * sums[M_Y + m]
        size += g * (xx * sums[SIZE_0 + m] + sums[SIZE_YY + m])
        variance += g * g * (xx * (xx * sums[VAR_0 + m] + sums[VAR_YY + m]
                                   + sums[VAR_YY + m]) + sums[VAR_YYYY + m])
    return float(straight), float(2 * oblique), float(size), float(variance / 2)


@reordered
def _set_moments(fit: Fit, windows: Windows, i: int, per_width: float, sums: np.ndarray) -> None:
    """Fill the sums over y of each column of window i."""
    sums[:] = 0
    none = np.float32(0)
    for k in range(fit.own.shape[1]):
        down = windows.corner[i, 1] + k - fit.parameters[i, V]
        g, y = np.float32(math.exp(-down * down * per_width)), np.float32(down)
        yy = y * y
        for m in range(fit.own.shape[2]):
            weight, own, model = fit.weight[i, k, m], fit.own[i, k, m], fit.model[i, k, m]
            used = g if weight > none else none
            variance = used * used / weight if weight > none else none
            size = used * (own if own > model else model)
            own *= used
            sums[M_0 + m] += own
            sums[M_Y + m] += own * y
            sums[M_YY + m] += own * yy
            sums[SIZE_0 + m] += size
            sums[SIZE_YY + m] += size * yy
            sums[VAR_0 + m] += variance
            sums[VAR_YY + m] += variance * yy
            sums[VAR_YYYY + m] += variance * yy * yy
