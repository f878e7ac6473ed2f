"""Does a fitted spot look like a star: width and elongation."""

import math
from typing import NamedTuple

import numpy as np

from startracker_ros.centroid.gaussian_fit import Fit, FLUX, profile, SIGMA, U, V
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import compiled, fused

WIDTH_RATIO = 2.0  # the other hypotheses: half as wide, twice as wide
MARGIN = 9.0  # of chi2, by which another width must be better
MAX_ELONGATION = 0.4
LONE_PIXEL = 0.3  # less light than this share of a pixel in the eight around it


class Shape(NamedTuple):
    """What is wrong with each of K spots, all (K,) bool.

    narrow: hot pixels and cosmic hits; wide: spots that no star makes; elongated: streaks.
    """

    narrow: np.ndarray
    wide: np.ndarray
    elongated: np.ndarray


@compiled
def lone_pixels(data):
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
    """Return the shapes of all spots.

    Spots chained to an elongated one are part of it, as the fit of neighbours in turns cuts
    a long streak into round pieces.
    """
    return Shape(*_judge(fit, windows))


@compiled
def streaks(fit, windows):
    """Return True (K,) for elongated spots, each looked at alone."""
    streak = np.empty(len(fit.parameters), np.bool_)
    for i in range(len(streak)):
        streak[i] = _elongated(fit, windows, i)
    return streak


@compiled
def _judge(fit, windows):
    stars, count = windows.data.shape[:2]
    narrow, wide = np.empty(stars, np.bool_), np.empty(stars, np.bool_)
    streak = streaks(fit, windows)
    share = np.empty((2, 3, count))
    for i in range(stars):
        narrow[i] = fit.chi2[i] - _chi2_of_width(fit, windows, i, 1 / WIDTH_RATIO, share) > MARGIN
        wide[i] = fit.chi2[i] - _chi2_of_width(fit, windows, i, WIDTH_RATIO, share) > MARGIN
    grown = streak.any()
    while grown:
        grown = False
        for i in range(stars):
            for k in range(windows.first[i], windows.first[i + 1]):
                if streak[windows.sources[k]] and not streak[i]:
                    streak[i] = grown = True
    return narrow, wide, streak


@fused
def _chi2_of_width(fit, windows, i, ratio, share):
    """Return chi2 of a star `ratio` times as wide at the same place, flux and level free."""
    star, count = fit.parameters[i], windows.data.shape[1]
    profile(star[U], star[SIGMA] * ratio, windows.corner[i, 0], share[0])
    profile(star[V], star[SIGMA] * ratio, windows.corner[i, 1], share[1])
    total = s = d = ss = sd = dd = 0.0
    for y in range(count):
        for x in range(count):
            if windows.used[i, y, x]:
                weight = 1 / fit.variance[i, y, x]
                shape, data = share[1, 0, y] * share[0, 0, x], fit.own[i, y, x]
                total, s, d = total + weight, s + weight * shape, d + weight * data
                ss, sd = ss + weight * shape * shape, sd + weight * shape * data
                dd += weight * data * data
    return dd - d * d / total - (sd - s * d / total) ** 2 / (ss - s * s / total)


@compiled
def _elongated(fit, windows, i):
    """Return whether spot i is a streak, by second moments under a Gaussian twice a star's width.

    The elongation is (a - b) / (a + b) of the moments a, b along the axes of the spot; it must
    exceed MAX_ELONGATION by three times its error.
    """
    star, count = fit.parameters[i], windows.data.shape[1]
    straight = oblique = size = error = 0.0
    for k in range(count):
        y = windows.corner[i, 1] + k - star[V]
        for m in range(count):
            if not windows.used[i, k, m]:
                continue
            x = windows.corner[i, 0] + m - star[U]
            square = x * x + y * y
            weight = math.exp(-square / (8 * star[SIGMA] ** 2))
            straight += weight * (x * x - y * y) * fit.own[i, k, m]
            oblique += weight * 2 * x * y * fit.own[i, k, m]
            size += weight * square * max(fit.own[i, k, m], fit.light[i, k, m])
            error += weight ** 2 * square ** 2 * fit.variance[i, k, m] / 2
    return math.hypot(straight, oblique) > MAX_ELONGATION * size + 3 * math.sqrt(error)


@compiled
def repeated(fit, windows, apart_px):
    """Return True (K,) for the fainter of two fits that are closer than apart_px."""
    twice = np.zeros(len(fit.parameters), np.bool_)
    for i in range(len(twice)):
        for k in range(windows.first[i], windows.first[i + 1]):
            star, other = fit.parameters[i], fit.parameters[windows.sources[k]]
            if math.hypot(star[U] - other[U], star[V] - other[V]) < apart_px:
                twice[i] |= star[FLUX] < other[FLUX]
    return twice
