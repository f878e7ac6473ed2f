# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Windows of single stars for tests of the fits, without an image around them."""

from native_fits import Field, Windows
import numpy as np
from scipy.stats import norm


def psf_image(star: np.ndarray, side_px: int) -> np.ndarray:
    """Return a star (u, v, flux, level, sigma) as a Gaussian integrated over pixels."""
    u, v, flux, level, sigma = star[:5]
    a, d = (np.diff(norm.cdf(np.arange(-0.5, side_px), centre, sigma)) for centre in (u, v))
    return level + flux * np.outer(d, a)


def windows_of(data: np.ndarray, variance: float) -> Windows:
    """Return windows of data (K, n, n) DN above the background, each far from the others."""
    windows = Windows(len(data), data.shape[1])
    windows.data[:], windows.used[:], windows.variance[:] = data, 1.0, variance
    windows.corner[:, 0] = FAR_PX * np.arange(len(data))
    return windows


FAR_PX = 1000
"""Between the corners of windows: by it the places of stars in their windows are moved."""


def moved(stars: np.ndarray, sign: int = 1) -> np.ndarray:
    """Return stars (K, ...) at their places in the windows, or back from there."""
    there = stars.copy()
    there[:, 0] += sign * FAR_PX * np.arange(len(stars))
    return there


def field_without_background(image: np.ndarray, level: float = 0.0, noise: float = 1.0) -> Field:
    """Return what the fits see of an image (H, W) uint16 over a background that is the same."""
    tiles = tuple(side // 64 + 2 for side in image.shape)
    return Field(image, np.full(tiles, level), np.full(tiles, noise), (level, noise),
                 (1 / 64, 1 / 64), 1.0, 65535.0, np.empty((0, 7)))
