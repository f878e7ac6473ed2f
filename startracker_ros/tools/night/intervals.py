# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Figures with their 95 % confidence intervals."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
_TAILS = (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2
_Z = float(stats.norm.ppf(_TAILS[1]))
_RESAMPLES = 300
BLOCKS = 10


class Interval(NamedTuple):
    """A value and the ends of its confidence interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> 'Interval':
        """Return the interval in another unit, factor > 0."""
        return Interval(*(factor * end for end in self))


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def successive_sigma(values: np.ndarray, joined: np.ndarray) -> Interval:
    """
    Return the standard deviation of the fast part of series (F, A), all axes pooled.

    joined (F - 1,) is which neighbours are close in time. s^2 = mean (x_i+1 - x_i)^2 / 2 does not
    see slow drifts; n differences have 2 n^2 / (3 n - 1) degrees of freedom for white noise (von
    Neumann, Ann. Math. Statist. 12, 1941).
    """
    differences = np.diff(values, axis=0)[joined]
    count, axes = differences.shape
    if count < 2:
        return UNKNOWN
    variance = float(np.mean(differences ** 2)) / 2
    degrees = axes * 2 * count ** 2 / (3 * count - 1)
    high, low = variance * degrees / stats.chi2.ppf(_TAILS, degrees)
    return Interval(*np.sqrt([variance, low, high]).tolist())


def root(square: float, sigma: float, found: bool = True) -> Interval:
    """Return the root of an unbiased estimate of a square; low is 0 where nothing was found."""
    low, high = square - _Z * sigma, square + _Z * sigma
    return Interval(*np.sqrt(np.maximum([square, low if found else 0.0, high], 0)).tolist())


def normal(value: float, sigma: float, degrees: float = np.inf) -> Interval:
    """Return a value of a normal error, whose sigma has so many degrees of freedom."""
    half = float(stats.t.ppf(_TAILS[1], degrees)) * sigma
    return Interval(value, value - half, value + half)


def share(count: float, trials: float) -> Interval:
    """Return a share in % (Clopper and Pearson, Biometrika 26, 1934); counts may be weighted."""
    if not trials:
        return UNKNOWN
    low = stats.beta.ppf(_TAILS[0], count, trials - count + 1) if count > 0 else 0.0
    high = stats.beta.ppf(_TAILS[1], count + 1, trials - count) if count < trials else 1.0
    return Interval(count / trials, float(low), float(high)).scaled(100)


def bootstrapped(statistic: Callable[[np.ndarray], float], count: int) -> Interval:
    """Return statistic(rows) of count independent rows (Efron, Ann. Statist. 7, 1979)."""
    if count < 2:
        return UNKNOWN
    rng = np.random.default_rng(count)
    resampled = [statistic(rng.integers(0, count, count)) for _ in range(_RESAMPLES)]
    low, high = np.nanpercentile(resampled, np.multiply(100, _TAILS))
    return Interval(statistic(np.arange(count)), float(low), float(high))


def independent(values: np.ndarray) -> int:
    """
    Return how many independent values have the mean of a series (F,) as accurately.

    F over the integrated autocorrelation time, the sum of which ends where pairs of neighbours
    are no longer positive (Geyer 1992, initial positive sequence).
    """
    deviation = values - np.mean(values)
    correlation = np.correlate(deviation, deviation, 'full')[len(values) - 1:]
    correlation /= correlation[0]
    pairs = correlation[:len(values) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = np.argmax(pairs <= 0) if np.any(pairs <= 0) else len(pairs)
    return max(1, int(len(values) / (2 * pairs[:end].sum() - 1)))


def chi_square_mean(values: np.ndarray, degrees: int) -> Interval:
    """Return the mean over its degrees of freedom of a correlated series of chi-squares (F,)."""
    total = degrees * independent(values)
    mean = float(np.mean(values)) / degrees
    high, low = mean * total / stats.chi2.ppf(_TAILS, total)
    return Interval(mean, float(low), float(high))


def block_mean(values: np.ndarray) -> Interval:
    """Return the mean of a series (F,) of correlated neighbours, by the means of its blocks."""
    if len(values) < 2 * BLOCKS:
        return UNKNOWN
    means = np.array([block.mean() for block in np.array_split(values, BLOCKS)])
    return normal(float(values.mean()), float(means.std(ddof=1)) / BLOCKS ** 0.5, BLOCKS - 1)


def block_trend(time_s: np.ndarray, values: np.ndarray, degree: int) -> Interval:
    """
    Return the coefficient of time^degree in a series (F,), by its blocks.

    The scatter of the means of blocks about the polynomial is noise and wander together, so that
    a wander within blocks is not stated as a drift.
    """
    if len(values) < 2 * BLOCKS:
        return UNKNOWN
    means = np.array([(np.mean(time_s[rows]), np.mean(values[rows]))
                      for rows in np.array_split(np.arange(len(values)), BLOCKS)])
    powers = np.vander(means[:, 0], degree + 1)
    inverse = np.linalg.pinv(powers)
    coefficients = inverse @ means[:, 1]
    degrees = BLOCKS - degree - 1
    variance = float(np.sum((means[:, 1] - powers @ coefficients) ** 2)) / degrees
    return normal(float(coefficients[0]), float(np.sqrt(variance * inverse[0] @ inverse[0])),
                  degrees)
