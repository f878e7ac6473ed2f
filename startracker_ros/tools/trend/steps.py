# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps in a series with a drift and an oscillation of the orbit."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

FALSE_ALARM = 1e-10
"""Of one date. A month has 43,200 of them, at 1 a minute."""

WINDOW_ORBITS = 8.0
"""A drift over a window makes the variance of a step four times that of two means, and one orbit
on each side leaves a step nearly equal to a sum of harmonics: longer windows find smaller steps,
as long as drift and oscillation stay what they are."""

_LEAST_BINS = 20
_MOST_STEPS = 50
_HARMONICS = 2
_BLOCK = 10_000


@dataclass(frozen=True)
class Step:
    """A step: stamp of the first bin after it, size (K,), its 1 sigma (K,), significance."""

    stamp_ns: int
    size: np.ndarray
    sigma: np.ndarray
    significance: float


@dataclass(frozen=True)
class StepSearch:
    """
    The steps of a series, largest first, and least (K,), the smallest that would be found.

    least is that at the median date, along one column; NaN for a series that is too short.
    """

    steps: list[Step]
    least: np.ndarray


def find_steps(stamp_ns: np.ndarray, values: np.ndarray, orbit_s: float) -> StepSearch:
    """
    Search a series (N, K) of bins at ascending stamps (N,) for steps.

    About each date a constant, a drift, two harmonics of the orbit and a step are fitted by least
    squares, to WINDOW_ORBITS on both sides. The columns are whitened by the scatter from bin to
    bin. A step counts where the sum of the squares over sigma^2 exceeds chi-square with K degrees
    of freedom at FALSE_ALARM, after sigma was scaled to the scatter of all fits without it.
    """
    known = np.isfinite(values).all(axis=1)
    stamps, columns = stamp_ns[known], values.shape[1]
    if len(stamps) < 2 * _LEAST_BINS:
        return StepSearch([], np.full(columns, np.nan))
    time_s = (stamps - stamps[0]) * 1e-9
    whitening, unwhitened = _whitening(values[known])
    white, found = values[known] @ whitening, list[Step]()
    limit = gate(FALSE_ALARM, columns)
    scale = np.ones(columns)
    size, variance = _fits(time_s, white, orbit_s)
    while len(found) < _MOST_STEPS:
        best = int((((size / scale) ** 2).sum(axis=1) / variance).argmax())
        date = best + _LEAST_BINS
        without = white - (np.arange(len(white)) >= date)[:, None] * size[best]
        # Noise that is not white makes all fits scatter more, also those without this step.
        sizes_without, _ = _fits(time_s, without, orbit_s)
        scatter = np.maximum(1.0, SIGMA_PER_MAD * np.median(
            np.abs(sizes_without) / np.sqrt(variance)[:, None], axis=0))
        significance = float(np.sum((size[best] / scatter) ** 2) / variance[best])
        if not significance > limit:
            if (scatter <= scale).all():
                break
            scale = np.maximum(scale, scatter)
            continue
        found.append(Step(
            int(stamps[date]), size[best] @ unwhitened,
            np.sqrt(variance[best] * (scatter ** 2 @ unwhitened ** 2)), significance))
        white, size = without, sizes_without
    # Along column k a step s is s * whitening[k] in units of the noise.
    unit = np.sqrt(np.sum((whitening / scale) ** 2, axis=1))
    return StepSearch(found, np.sqrt(limit * np.median(variance)) / unit)


def _whitening(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix (K, K) that makes the columns white, with variance 1, and its inverse."""
    change = np.diff(values, axis=0) / np.sqrt(2)
    # Without the steps themselves.
    size = np.abs(change - np.median(change, axis=0))
    usual = (size <= 6 * SIGMA_PER_MAD * np.median(size, axis=0) + 1e-300).all(axis=1)
    covariance = np.atleast_2d(np.cov(change[usual].T)) + 1e-300 * np.eye(values.shape[1])
    variance, axes = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(variance, 1e-300))
    return axes / sigma, (axes * sigma).T


def _fits(time_s: np.ndarray, white: np.ndarray, orbit_s: float
          ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the steps (D, K), in units of the noise, and their variance (D,) at each date.

    Dates are the bins but for _LEAST_BINS at both ends. Blocks keep times small numbers.
    """
    dates = np.arange(_LEAST_BINS, len(time_s) - _LEAST_BINS)
    window_s = WINDOW_ORBITS * orbit_s
    sizes, variances = [np.empty((0, white.shape[1]))], [np.empty(0)]
    for begin in range(0, len(dates), _BLOCK):
        block = dates[begin:begin + _BLOCK]
        first = np.searchsorted(time_s, time_s[block[0]] - window_s)
        last = np.searchsorted(time_s, time_s[block[-1]] + window_s)
        size, variance = _block_fits(time_s[first:last], white[first:last], block - first,
                                     orbit_s, window_s)
        sizes.append(size)
        variances.append(variance)
    return np.concatenate(sizes), np.concatenate(variances)


def _block_fits(time_s: np.ndarray, white: np.ndarray, dates: np.ndarray, orbit_s: float,
                window_s: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the steps (D, K) and their variance (D,) at dates (D,), out of running sums.

    With the other columns B and the step h, 1 from the date on, all within the window:
    1 / variance = h'h - h'B (B'B)^-1 B'h, size = variance (h'y - h'B (B'B)^-1 B'y).
    """
    t = time_s - time_s[len(time_s) // 2]
    phase = 2 * np.pi * t / orbit_s
    B = np.stack([np.ones(len(t)), t / window_s, *(
        function(harmonic * phase) for harmonic in range(1, _HARMONICS + 1)
        for function in (np.sin, np.cos))], -1)
    begin = np.searchsorted(time_s, time_s[dates] - window_s)
    end = np.searchsorted(time_s, time_s[dates] + window_s)
    squares = _running_sum(B[:, :, None] * B[:, None])
    products = _running_sum(B[:, :, None] * white[:, None])
    sums, data = _running_sum(B), _running_sum(white)
    normal = squares[end] - squares[begin]
    # A window shorter than an orbit cannot tell a step from the oscillation.
    normal += 1e-9 * (end - begin)[:, None, None] * np.eye(B.shape[1])
    after = sums[end] - sums[dates]
    weight = np.linalg.solve(normal, after[..., None])[..., 0]
    variance = 1 / ((end - dates) * (1 + 1e-9) - np.sum(weight * after, axis=1))
    size = variance[:, None] * (data[end] - data[dates] - np.einsum(
        'db,dbk->dk', weight, products[end] - products[begin]))
    return size, variance


def _running_sum(values: np.ndarray) -> np.ndarray:
    """Return the sums (N + 1, ...) of the values before each."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def drift(stamp_ns: np.ndarray, values: np.ndarray, steps: list[Step]) -> np.ndarray:
    """Return the slope (K,) of a series (N, K) in a day, steps removed."""
    known = np.isfinite(values).all(axis=1)
    if np.count_nonzero(known) < 2:
        return np.full(values.shape[1], np.nan)
    time_d = (stamp_ns[known] - stamp_ns[known][0]) / 86400e9
    cleaned = values[known] - sum(
        (stamp_ns[known] >= step.stamp_ns)[:, None] * step.size for step in steps)
    return np.polyfit(time_d, cleaned, 1)[0]
