# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of the mean of normalised errors squared (NEES) of frames in a row."""

import numpy as np
from startracker_ros.tools.figures.rows import mean_chi_square_bounds


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


def check_mean(degrees: int, *series: np.ndarray, inflation: float = 1.0) -> None:
    """
    Check that the mean of series (F,) of correlated chi-squares is within its 95 % bounds.

    With inflation a covariance may be so much larger than that of the errors, as that of a filter
    is which allows for what does not happen.
    """
    low, high = mean_chi_square_bounds(degrees, sum(map(independent, series)))
    mean = np.concatenate(series).mean()
    assert low / inflation < mean < high, (low / inflation, mean, high)
