# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star images with known truth, and the Cramer-Rao bound of their centroids."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

SIZE_PX = 1024
STARS = 30
PSF_SIGMA_PX = 0.8
SKY_E = 200.0
SKY_GRADIENT = 0.1  # from the left edge to the right one, of the sky
READ_NOISE_E = 10.0
OFFSET_DN = 100.0  # at one electron a DN
_BORDER_PX = 12
_SEPARATION_PX = 16
_REACH_PX = 8


@dataclass(frozen=True)
class StarImage:
    """image (H, W) uint16 of stars at uv (N, 2) px; bound_px (N,) as of cramer_rao_px()."""

    image: np.ndarray
    uv: np.ndarray
    bound_px: np.ndarray


def flux_e(snr: float) -> float:
    """
    Return the electrons of a star of this SNR.

    SNR is the total flux over its error within the 4 pi sigma^2 pixels of a matched filter on
    a Gaussian star: F / sqrt(F + 4 pi sigma^2 (sky + read noise^2)).
    """
    return flux_above(snr, 4 * np.pi * PSF_SIGMA_PX ** 2 * (SKY_E + READ_NOISE_E ** 2))


def flux_above(snr: float, noise_e2: float) -> float:
    """Return the electrons F for which F / sqrt(F + noise_e2) is an SNR."""
    return float(snr ** 2 + np.sqrt(snr ** 4 + 4 * snr ** 2 * noise_e2)) / 2


def star_image(snr: float, rng: np.random.Generator) -> StarImage:
    """Return stars of one SNR at random positions, none near another or the border."""
    uv = _positions(rng)
    flux, sky = flux_e(snr), _sky()
    electrons = np.tile(sky, (SIZE_PX, 1))
    bound_px = np.empty(STARS)
    for i, centre in enumerate(uv):
        corner = np.rint(centre).astype(int) - _REACH_PX
        u, v = (slice(first, first + 2 * _REACH_PX + 1) for first in corner)
        electrons[v, u] += flux * _share(centre - corner)
        bound_px[i] = cramer_rao_px(centre - corner, flux, sky[u])
    signal = rng.poisson(electrons) + READ_NOISE_E * rng.standard_normal(electrons.shape)
    return StarImage(np.rint(signal + OFFSET_DN).clip(0, 65535).astype(np.uint16), uv, bound_px)


def cramer_rao_px(centre: np.ndarray, flux: float, sky: np.ndarray) -> float:
    """
    Return the bound of the error per axis: position and flux free, width and background known.

    centre (2,) px of the star within the window; sky (n,) electrons of its columns.
    """
    step = np.array([1e-3, 0.0])
    slopes = flux * np.stack([
        (_share(centre + step) - _share(centre - step)) / 2e-3,
        (_share(centre + step[::-1]) - _share(centre - step[::-1])) / 2e-3,
        _share(centre) / flux]).reshape(3, -1)
    variance = (flux * _share(centre) + sky + READ_NOISE_E ** 2).ravel()
    covariance = np.linalg.inv(slopes / variance @ slopes.T)
    return float(np.sqrt((covariance[0, 0] + covariance[1, 1]) / 2))


def _positions(rng: np.random.Generator) -> np.ndarray:
    uv = np.empty((0, 2))
    while len(uv) < STARS:
        candidate = rng.uniform(_BORDER_PX, SIZE_PX - 1 - _BORDER_PX, 2)
        if (np.abs(uv - candidate).max(1, initial=0) >= _SEPARATION_PX).all():
            uv = np.vstack([uv, candidate])
    return uv


def _sky() -> np.ndarray:
    """Return the electrons of the sky (W,) in each column."""
    return SKY_E * (1 + SKY_GRADIENT * np.linspace(-0.5, 0.5, SIZE_PX))


def _share(centre: np.ndarray) -> np.ndarray:
    """Return the share of a star's light in the pixels (n, n) of a window, n = 2 reach + 1."""
    edge = np.arange(2 * _REACH_PX + 2) - 0.5
    across, down = (np.diff(ndtr((edge - each) / PSF_SIGMA_PX)) for each in centre)
    return np.outer(down, across)
