# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The information on the attitude that the stars of an image would have at other settings."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from startracker_ros.core.exposure.image_figures import ImageFigures

# The number of stars grows by 10^(0.45 m) with magnitude m near V = 6, and so by this power of
# the flux.
_COUNT_SLOPE = 1.1
_FAINTER = 100  # stars beyond those that were found
_SEEN_SNR = 4.0, 7.0  # from none to all stars of this signal to noise ratio are detected
_ERROR_PX = 0.05  # of a star whatever its signal: catalogue, lens, pixels
_SATURATED_PX = 0.3  # of one that is fitted by its flanks
_SMEARED = 0.03  # of a streak: the motion is not quite uniform
_ROUNDING = 1 / 12  # DN^2, variance of a rounded level
_DARKEST = 0.25  # part of the field in which the stars are seen if the rest is too bright
_SATURATED = 0.95  # of the full scale, with the noise


class Converter(NamedTuple):
    """The levels of a pixel without light, and where it saturates, in DN."""

    dark_dn: float
    full_scale_dn: float


def filled(figures: ImageFigures, converter: Converter) -> float:
    """Return the part of the full scale that the background fills in the darkest quarter."""
    dark_dn, full_scale_dn = converter
    background_dn = float(np.quantile(figures.levels_dn, _DARKEST))
    return (background_dn - dark_dn) / (full_scale_dn - dark_dn)


def information(figures: ImageFigures, converter: Converter, longer: np.ndarray,
                amplified: np.ndarray) -> np.ndarray:
    """
    Return the information (C,) in 1/px^2 at longer (C,) times the exposure.

    amplified (C,) is the gain by those of the image. It is the sum of the inverse variances of
    the stars, those included that would appear or saturate. The variance of the flux F of a star
    is k F + a: photons of the star, read noise and photons of the background, the share of the
    last by the same k. There must be a star.
    """
    dark_dn, full_dn = converter
    f, h = longer[:, None], amplified[:, None]
    gain_dn, floor = _flux_variance(figures)
    variance = max(figures.noise_dn ** 2, _ROUNDING)
    sky = min(max(gain_dn * (figures.background_dn - dark_dn) / variance, 0.0), 1.0)
    flux, peak_dn = _with_fainter(figures)
    # The pixels over which the background counts grow with the streak.
    sharp = figures.psf_sigma_px
    along, long = (np.sqrt(sharp ** 2 + (figures.streak_px * times) ** 2 / 12)
                   for times in (1.0, f))
    pixel = h ** 2 * (variance - _ROUNDING) * (1 + sky * (f - 1)) + _ROUNDING
    snr = flux * f * h / np.sqrt(
        gain_dn * flux * f * h ** 2 + floor * pixel / variance * long / along)
    own = (np.where((peak_dn - dark_dn) * f * h < _SATURATED * (full_dn - dark_dn),
                    _ERROR_PX, _SATURATED_PX) ** 2
           + (_SMEARED * figures.streak_px * f) ** 2)
    low, high = _SEEN_SNR
    seen = ((snr - low) / (high - low)).clip(0, 1)
    snr = np.maximum(snr, low)
    each = (1 / ((sharp / snr) ** 2 + own) + 1 / ((long / snr) ** 2 + own)) / 2
    return (seen * each).sum(axis=1) * _regained(figures, converter, longer * amplified)


def _flux_variance(figures: ImageFigures) -> tuple[float, float]:
    """Return k in DN and a in DN^2 of the variance k F + a of the fluxes F of the stars."""
    variance = (figures.flux / figures.snr) ** 2
    (gain_dn, floor), _ = nnls(np.stack([figures.flux, np.ones_like(variance)], 1)
                               / variance[:, None], np.ones(len(variance)))
    return float(gain_dn), float(floor)


def _with_fainter(figures: ImageFigures) -> tuple[np.ndarray, np.ndarray]:
    """Return fluxes and peaks of the stars, followed by fainter ones as the sky has them."""
    least, count = np.argmin(figures.flux), len(figures.flux)
    share = ((count + np.arange(_FAINTER) + 0.5) / count) ** (-1 / _COUNT_SLOPE)
    return (np.append(figures.flux, figures.flux[least] * share),
            np.append(figures.peak_dn, np.full(_FAINTER, figures.peak_dn.min())))


def _regained(figures: ImageFigures, converter: Converter, brighter: np.ndarray) -> np.ndarray:
    """
    Return the part (C,) of the field that can be used, by that of the image, if less saturates.

    Behind full pixels a gradient is taken to go on as before them; the edge of a disc has none.
    """
    dark_dn, full_dn = converter
    limit_dn = _SATURATED * (full_dn - dark_dn)
    light_dn = figures.levels_dn - dark_dn
    full = np.mean(light_dn >= limit_dn)
    below = (light_dn < limit_dn) & (light_dn >= limit_dn * brighter[:, None])
    return 1 + np.minimum(below.mean(axis=1), full) / max(1 - full, 0.01)
