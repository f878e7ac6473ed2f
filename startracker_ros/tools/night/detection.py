# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which stars are found: the share by magnitude and the limiting magnitude."""

import numpy as np
from scipy.optimize import minimize
from startracker_ros.tools.night.intervals import bootstrapped, Interval, share, UNKNOWN
from startracker_ros.tools.night.stars import Stars

BIN_MAG = 0.5
_LEAST_WIDTH_MAG = 0.01


def shares_by_magnitude(stars: Stars) -> list[tuple[float, Interval]]:
    """
    Return the lower end of each bin of magnitude and the share in % of its stars found.

    The frames of one star are not independent: each star is a trial with the share of its frames.
    """
    magnitude, found, trials = per_star(stars)
    bins = np.floor(magnitude / BIN_MAG)
    return [(float(each * BIN_MAG), share(float(np.sum((found / trials)[bins == each])),
                                          int(np.sum(bins == each))))
            for each in np.unique(bins)]


def limiting_magnitude(stars: Stars) -> Interval:
    """
    Return the magnitude of which half of the stars are found; unknown where all or none are.

    Logistic regression p = 1 / (1 + exp((m - m50) / w)), its interval by resampling stars.
    """
    magnitude, found, trials = per_star(stars)
    if not 0 < found.sum() < trials.sum():
        return UNKNOWN
    return bootstrapped(lambda rows: _half(magnitude[rows], found[rows], trials[rows]),
                        len(magnitude))


def per_star(stars: Stars) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return magnitude, frames with a centroid and frames in view (S,) of each star."""
    _, first, star = np.unique(stars.star, return_index=True, return_inverse=True)
    return (stars.magnitude[first], np.bincount(star, stars.seen).astype(float),
            np.bincount(star).astype(float))


def _half(magnitude: np.ndarray, found: np.ndarray, trials: np.ndarray) -> float:
    if not 0 < found.sum() < trials.sum():
        return np.nan
    start = np.array([np.average(magnitude, weights=np.maximum(found, 1e-9)), np.log(0.3)])

    def loss(parameters: np.ndarray) -> float:
        width = max(float(np.exp(parameters[1])), _LEAST_WIDTH_MAG)
        steps = (magnitude - parameters[0]) / width
        return float(found @ np.logaddexp(0, steps) + (trials - found) @ np.logaddexp(0, -steps))
    return float(minimize(loss, start, method='Nelder-Mead').x[0])
