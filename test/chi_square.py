# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of the mean of normalised errors squared (NEES) of frames in a row."""

import numpy as np
from startracker_ros.tools.figures.rows import mean_chi_square_bounds
from startracker_ros.tools.night.intervals import independent


def check_mean(degrees: int, *series: np.ndarray, inflation: float = 1.0) -> None:
    """
    Check that the mean of series (F,) of correlated chi-squares is within its 95 % bounds.

    With inflation a covariance may be so much larger than that of the errors, as that of a filter
    is which allows for what does not happen.
    """
    low, high = mean_chi_square_bounds(degrees, sum(map(independent, series)))
    mean = np.concatenate(series).mean()
    assert low / inflation < mean < high, (low / inflation, mean, high)
