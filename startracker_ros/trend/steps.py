"""Steps in a series with a drift and an oscillation of the orbit."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

FALSE_ALARM = 1e-10
"""Of one date. A month has 43,200 of them, at 1 a minute."""

_WINDOW_ORBITS = 2.0
_LEAST_BINS = 20
_MOST_STEPS = 50
_STRIDE = 5
_HARMONICS = 2
_MAD = 1.4826


@dataclass(frozen=True)
class Step:
    """A step: stamp of the first bin after it, size (K,), its 1 sigma (K,), significance."""

    stamp_ns: int
    size: np.ndarray
    sigma: np.ndarray
    significance: float


def find_steps(stamp_ns: np.ndarray, values: np.ndarray, orbit_s: float) -> list[Step]:
    """
    Return the steps of a series (N, K) of bins at ascending stamps (N,), largest first.

    About each date a constant, a drift, two harmonics of the orbit and a step are fitted by least
    squares, to two orbits on both sides. The columns are whitened by the scatter from bin to bin.
    A step counts where the sum of the squares over sigma^2 exceeds chi-square with K degrees of
    freedom at FALSE_ALARM, after sigma was scaled to the scatter of all fits without it.
    """
    known = np.isfinite(values).all(axis=1)
    time_s = (stamp_ns[known] - stamp_ns[0]) * 1e-9 if len(stamp_ns) else np.empty(0)
    values = values[known]
    if len(time_s) < 2 * _LEAST_BINS:
        return []
    whitening, unwhitened = _whitening(values)
    white, found = values @ whitening, list[Step]()
    limit = chi2.isf(FALSE_ALARM, values.shape[1])
    dates = np.arange(_LEAST_BINS, len(time_s) - _LEAST_BINS, _STRIDE)
    scale = np.ones(values.shape[1])
    while len(found) < _MOST_STEPS:
        parts = _parts(time_s, white, dates, orbit_s)
        best = int(dates[((parts / scale) ** 2).sum(axis=1).argmax()])
        near = np.arange(max(best - _STRIDE, _LEAST_BINS),
                         min(best + _STRIDE + 1, len(time_s) - _LEAST_BINS))
        date = int(near[((_parts(time_s, white, near, orbit_s) / scale) ** 2).sum(
            axis=1).argmax()])
        size, variance = _fit(time_s, white, date, orbit_s)
        without = white - (np.arange(len(white)) >= date)[:, None] * size
        # Noise that is not white makes all fits scatter more, also those without this step.
        scatter = np.maximum(1.0, _MAD * np.median(np.abs(
            _parts(time_s, without, dates, orbit_s)), axis=0))
        significance = float(np.sum((size / scatter) ** 2) / variance)
        if not significance > limit:
            if (scatter <= scale).all():
                break
            scale = np.maximum(scale, scatter)
            continue
        found.append(Step(
            int(stamp_ns[known][date]), size @ unwhitened,
            np.sqrt(variance * (scatter ** 2 @ unwhitened ** 2)), significance))
        white = without
    return found


def _parts(time_s: np.ndarray, white: np.ndarray, dates: np.ndarray, orbit_s: float
           ) -> np.ndarray:
    """Return the step over its 1 sigma (D, K) of each date (D,)."""
    fits = [_fit(time_s, white, int(date), orbit_s) for date in dates]
    return np.array([size / np.sqrt(variance) for size, variance in fits])


def _whitening(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix (K, K) that makes the columns white, with variance 1, and its inverse."""
    change = np.diff(values, axis=0) / np.sqrt(2)
    # Without the steps themselves.
    size = np.abs(change - np.median(change, axis=0))
    usual = (size <= 6 * _MAD * np.median(size, axis=0) + 1e-300).all(axis=1)
    covariance = np.atleast_2d(np.cov(change[usual].T)) + 1e-300 * np.eye(values.shape[1])
    variance, axes = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(variance, 1e-300))
    return axes / sigma, (axes * sigma).T


def _fit(time_s: np.ndarray, white: np.ndarray, date: int, orbit_s: float
         ) -> tuple[np.ndarray, float]:
    """Return the step (K,) at a bin in units of the noise, and its variance."""
    window_s = _WINDOW_ORBITS * orbit_s
    begin = np.searchsorted(time_s, time_s[date] - window_s)
    end = np.searchsorted(time_s, time_s[date] + window_s)
    t = time_s[begin:end] - time_s[date]
    phase = 2 * np.pi * t / orbit_s
    columns = [np.arange(begin, end) >= date, np.ones(len(t)), t / window_s]
    for harmonic in range(1, _HARMONICS + 1):
        columns += [np.sin(harmonic * phase), np.cos(harmonic * phase)]
    design = np.stack(columns, -1).astype(float)
    normal = design.T @ design
    # A window shorter than an orbit cannot tell a step from the oscillation.
    normal[np.diag_indices(len(normal))] += 1e-9 * len(t)
    covariance = np.linalg.inv(normal)
    size = covariance[0] @ (design.T @ white[begin:end])
    return size, float(covariance[0, 0])


def drift(stamp_ns: np.ndarray, values: np.ndarray, steps: list[Step]) -> np.ndarray:
    """Return the slope (K,) of a series (N, K) in a day, steps removed."""
    known = np.isfinite(values).all(axis=1)
    if np.count_nonzero(known) < 2:
        return np.full(values.shape[1], np.nan)
    time_d = (stamp_ns[known] - stamp_ns[known][0]) / 86400e9
    cleaned = values[known] - sum(
        (stamp_ns[known] >= step.stamp_ns)[:, None] * step.size for step in steps)
    return np.polyfit(time_d, cleaned, 1)[0]
