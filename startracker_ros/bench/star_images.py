"""Star images whose truth is known, and the least error that their noise allows."""

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
_APART_PX = 16
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

    SNR is the total flux over its error within the 4 pi sigma^2 pixels that a matched filter
    takes of a Gaussian star: F / sqrt(F + 4 pi sigma^2 (sky + read noise^2)).
    """
    noise_e2 = 4 * np.pi * PSF_SIGMA_PX ** 2 * (SKY_E + READ_NOISE_E ** 2)
    return float(snr ** 2 + np.sqrt(snr ** 4 + 4 * snr ** 2 * noise_e2)) / 2


def star_image(snr: float, rng: np.random.Generator) -> StarImage:
    """Return stars of one SNR at random places, none near another or the border."""
    uv = _places(rng)
    flux, sky = flux_e(snr), _sky()
    electrons = np.tile(sky, (SIZE_PX, 1))
    bound_px = np.empty(STARS)
    for i, place in enumerate(uv):
        corner = np.rint(place).astype(int) - _REACH_PX
        u, v = (slice(first, first + 2 * _REACH_PX + 1) for first in corner)
        electrons[v, u] += flux * _share(place - corner)
        bound_px[i] = cramer_rao_px(place - corner, flux, sky[u])
    signal = rng.poisson(electrons) + READ_NOISE_E * rng.standard_normal(electrons.shape)
    return StarImage(np.rint(signal + OFFSET_DN).clip(0, 65535).astype(np.uint16), uv, bound_px)


def cramer_rao_px(place: np.ndarray, flux: float, sky: np.ndarray) -> float:
    """
    Return the bound of the error per axis: place and flux free, width and background known.

    place (2,) px within the window; sky (n,) electrons of its columns.
    """
    step = np.array([1e-3, 0.0])
    slopes = flux * np.stack([
        (_share(place + step) - _share(place - step)) / 2e-3,
        (_share(place + step[::-1]) - _share(place - step[::-1])) / 2e-3,
        _share(place) / flux]).reshape(3, -1)
    variance = (flux * _share(place) + sky + READ_NOISE_E ** 2).ravel()
    covariance = np.linalg.inv(slopes / variance @ slopes.T)
    return float(np.sqrt((covariance[0, 0] + covariance[1, 1]) / 2))


def _places(rng: np.random.Generator) -> np.ndarray:
    uv = np.empty((0, 2))
    while len(uv) < STARS:
        place = rng.uniform(_BORDER_PX, SIZE_PX - 1 - _BORDER_PX, 2)
        if (np.abs(uv - place).max(1, initial=0) >= _APART_PX).all():
            uv = np.vstack([uv, place])
    return uv


def _sky() -> np.ndarray:
    """Return the electrons of the sky (W,) in each column."""
    return SKY_E * (1 + SKY_GRADIENT * np.linspace(-0.5, 0.5, SIZE_PX))


def _share(place: np.ndarray) -> np.ndarray:
    """Return the share of a star's light in the pixels (n, n) of a window, n = 2 reach + 1."""
    edge = np.arange(2 * _REACH_PX + 2) - 0.5
    across, down = (np.diff(ndtr((edge - centre) / PSF_SIGMA_PX)) for centre in place)
    return np.outer(down, across)
