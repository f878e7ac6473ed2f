# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an image shows of its exposure and its focus."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.centroid.extraction import CentroidExtractor, Extraction

FWHM_PER_SIGMA = 2 * np.sqrt(2 * np.log(2))

_LEVELS = 200  # quantiles of the pixels
_PIXELS = 40_000  # of which they are
_DEPTHS = 8, 10, 12, 14, 16  # bits


@dataclass(frozen=True)
class ImageFigures:
    """
    Background, noise and stars of an image.

    levels_dn (Q,) are equidistant quantiles of its pixels; full_scale_dn is where they saturate,
    infinite where none does; brightest_dn that of all, and range_dn the full scale of the least
    depth that holds it, of 8 bit or of 12 and more. noise_dn is the 1 sigma of a pixel. flux (N,)
    in DN, snr (N,) and peak_dn (N,), the brightest pixel with its background, are those of the
    stars; psf_sigma_px and streak_px of all of them.
    """

    levels_dn: np.ndarray
    full_scale_dn: float
    brightest_dn: float
    range_dn: float
    noise_dn: float
    flux: np.ndarray
    snr: np.ndarray
    peak_dn: np.ndarray
    psf_sigma_px: float
    streak_px: float

    @classmethod
    def of(cls, image: np.ndarray, extraction: Extraction) -> 'ImageFigures':
        """Return the figures of image (H, W) uint8 or uint16 and what was extracted from it."""
        step = max(1, round((image.size / _PIXELS) ** 0.5))
        levels = np.quantile(image[::step, ::step], (np.arange(_LEVELS) + 0.5) / _LEVELS)
        stars = extraction.centroids
        v, u = (np.rint(stars.uv[:, axis]).astype(int) for axis in (1, 0))
        around = np.add.outer([-1, 0, 1], v).clip(0, image.shape[0] - 1)
        beside = np.add.outer([-1, 0, 1], u).clip(0, image.shape[1] - 1)
        peak_dn = image[around[:, None], beside[None]].max(axis=(0, 1))
        brightest = float(image.max())
        depths = (8,) if image.itemsize == 1 else (12, 14, 16)
        return cls(levels, _full_scale_dn(image, levels), brightest,
                   min(2.0 ** bits - 1 for bits in depths if brightest < 2 ** bits),
                   float(np.nan_to_num(extraction.noise_dn)), stars.flux, stars.snr,
                   peak_dn.astype(float), extraction.psf_sigma_px, extraction.streak_px)

    @property
    def background_dn(self) -> float:
        """Median level."""
        return float(np.median(self.levels_dn))

    @property
    def fwhm_px(self) -> float:
        """Full width at half maximum of the star images: the smaller, the better the focus."""
        return FWHM_PER_SIGMA * self.psf_sigma_px


def _full_scale_dn(image: np.ndarray, levels_dn: np.ndarray) -> float:
    """Return where image (H, W) saturates, infinity where it does not."""
    background_dn = float(np.median(levels_dn))
    if background_dn == image.max() and background_dn in [2 ** depth - 1 for depth in _DEPTHS]:
        return background_dn
    return CentroidExtractor().full_scale(image, background_dn)
