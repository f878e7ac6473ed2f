"""Does a fitted spot look like a star: width and elongation."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from startracker_ros.centroid.gaussian_fit import Fit, SIGMA, star_light, U, V
from startracker_ros.centroid.windows import Windows

WIDTH_RATIO = 2.0  # the other hypotheses: half as wide, twice as wide
MARGIN = 9.0  # of chi2, by which another width must be better
MAX_ELONGATION = 0.4


def chi2_of_width(fit: Fit, windows: Windows, ratio: float) -> np.ndarray:
    """Return chi2 (K,) of a star `ratio` times as wide at the same place, flux and level free."""
    stars, count = windows.data.shape[:2]
    other = fit.parameters.copy()
    other[:, 2] = 1
    other[:, SIGMA] *= ratio
    shape = star_light(other, windows.corner, count).reshape(stars, count * count)
    weight = (windows.used / fit.variance).reshape(stars, count * count)
    data = fit.own.reshape(stars, count * count)
    total = weight.sum(1)
    shape = shape - ((weight * shape).sum(1) / total)[:, None]
    data = data - ((weight * data).sum(1) / total)[:, None]
    overlap = (weight * shape * data).sum(1)
    return (weight * data * data).sum(1) - overlap ** 2 / (weight * shape * shape).sum(1)


def too_narrow(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for hot pixels and cosmic hits."""
    return fit.chi2 - chi2_of_width(fit, windows, 1 / WIDTH_RATIO) > MARGIN


def too_wide(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for spots that no star makes."""
    return fit.chi2 - chi2_of_width(fit, windows, WIDTH_RATIO) > MARGIN


def elongated(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for streaks, by second moments under a Gaussian twice as wide as a star.

    The elongation is (a - b) / (a + b) of the moments a, b along the axes of the spot; it must
    exceed MAX_ELONGATION by three times its error. Spots chained to such a one are part of it,
    as the fit of neighbours in turns cuts a long streak into round pieces.
    """
    stars, count = windows.data.shape[:2]
    place = windows.corner[:, :, None] + np.arange(count)
    x = (place[:, 0] - fit.parameters[:, U, None])[:, None, :]
    y = (place[:, 1] - fit.parameters[:, V, None])[:, :, None]
    width = 2 * fit.parameters[:, SIGMA, None, None]
    weight = np.exp(-0.5 * (x * x + y * y) / width ** 2) * windows.used
    difference, cross, total = x * x - y * y, 2 * x * y, x * x + y * y
    size = (weight * total * np.maximum(fit.own, fit.light)).sum((1, 2))
    elongation = np.hypot((weight * difference * fit.own).sum((1, 2)),
                          (weight * cross * fit.own).sum((1, 2))) / size
    error = np.sqrt((weight ** 2 * total ** 2 * fit.variance).sum((1, 2)) / 2) / size
    streak = elongation > MAX_ELONGATION + 3 * error
    if not streak.any():
        return streak
    pairs = coo_array((np.ones(len(windows.neighbours)), tuple(windows.neighbours.T)),
                      (stars, stars))
    _, chain = connected_components(pairs, directed=False)
    return np.isin(chain, chain[streak])
