# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Standard deviations of errors about the axes of a data sheet, with confidence intervals."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.tools.datasheet.single_images import ImageErrors, SHIFTS

EXACT = np.zeros((1, 2, 3))
"""Errors of the fields of a camera that is known exactly."""

AXES = {'cross boresight': slice(0, 2), 'about boresight': slice(2, 3)}
"""The axes of each name: both cross axes are pooled."""

_RESAMPLES = 200
_CONFIDENCE_PERCENT = (2.5, 97.5)


class Estimate(NamedTuple):
    """A value in arcsec, the ends of its 95 % confidence interval, and its physical bound."""

    value: float
    low: float
    high: float
    bound: float | None = None


def bootstrapped(statistic: Callable[..., float], *groups: np.ndarray) -> Estimate:
    """
    Return a statistic in rad of independent groups (G, ...), with its interval, in arcsec.

    The groups are resampled, of several arrays each by itself (Efron, Ann. Statist. 7, 1979, the
    percentile method).
    """
    rng = np.random.default_rng(len(groups[0]))
    if not all(np.isfinite(each).any() for each in groups):
        return Estimate(np.nan, np.nan, np.nan)
    resampled = [statistic(*(each[rng.integers(0, len(each), len(each))] for each in groups))
                 for _ in range(_RESAMPLES)]
    low, high = np.nanpercentile(resampled, _CONFIDENCE_PERCENT)
    return Estimate(*(float(value) / ARCSEC for value in (statistic(*groups), low, high)))


def rms(values: np.ndarray) -> float:
    """Return the root mean square of values, those that are NaN left out."""
    return _root_of_mean(np.square(values))


def _root_of_mean(squares: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else float('nan')


def temporal_noise(errors: ImageErrors, axes: slice) -> Estimate:
    """Return the noise equivalent angle, with the rms of the Cramer-Rao bounds."""
    bound = _root_of_mean(errors.bound[..., axes]) / ARCSEC
    return bootstrapped(rms, errors.noise[..., axes])._replace(bound=bound)


def pixel_spatial(errors: ImageErrors, axes: slice) -> Estimate:
    """Return the scatter of the errors without noise within the fields."""
    return bootstrapped(_within, _complete(errors.spatial[..., axes]))


def fov_spatial(calibrations: np.ndarray, errors: ImageErrors, axes: slice) -> Estimate:
    """
    Return the scatter of the errors from field to field.

    It is that of each of the calibrations (C, F, 3), and that of the images of a camera known
    exactly, less what the pixels add to it.
    """
    return bootstrapped(
        lambda each, images: float(np.hypot(_scatter(each), _between(images))),
        calibrations[..., axes], _complete(errors.spatial[..., axes]))


def bias(calibrations: np.ndarray, errors: ImageErrors, axes: slice) -> Estimate:
    """Return the rms over the calibrations (C, F, 3) of the length of the mean error."""
    return bootstrapped(
        lambda each, images: float(np.sqrt(np.mean(np.sum(np.square(
            np.nanmean(each, axis=1) + np.mean(images, axis=(0, 1))), axis=-1)))),
        calibrations[..., axes], _complete(errors.spatial[..., axes]))


def _complete(spatial: np.ndarray) -> np.ndarray:
    """Return the fields (G, SHIFTS, A) with an attitude in each image."""
    return spatial[np.isfinite(spatial).all(axis=(1, 2))]


def _scatter(calibrations: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.nanvar(calibrations, axis=1, ddof=1))))


def _within(groups: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.var(groups, axis=1, ddof=1))))


def _between(groups: np.ndarray) -> float:
    if len(groups) < 2:
        return float('nan')
    variance = np.mean(np.var(groups.mean(axis=1), axis=0, ddof=1))
    return float(np.sqrt(max(variance - _within(groups) ** 2 / SHIFTS, 0.0)))
