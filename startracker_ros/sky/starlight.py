"""The light of point sources on a sensor: a Gaussian, integrated over square pixels."""

import math

import numpy as np
from startracker_ros.compiled import compiled

_REACH = 5
"""In sigma. The light beyond, 6e-7 of the star, moves a centroid by less than 2e-6 sigma."""


@compiled
def reach_px(sigma_px: float) -> int:
    """Return how far, in px, a source of width sigma_px sheds light."""
    return math.ceil(_REACH * sigma_px)


@compiled
def add_starlight(uv: np.ndarray, electrons: np.ndarray, sigma_px: np.ndarray,
                  response: np.ndarray, light: np.ndarray) -> None:
    """
    Add sources at uv (N, 2) px of electrons (N,) and sigma_px (N,) to light (H, W) float32.

    response (H, W) float32 is the sensitivity of each pixel.
    """
    height, width = light.shape
    half = reach_px(sigma_px.max()) if len(sigma_px) else 0
    across, down = np.empty(2 * half + 1), np.empty(2 * half + 1)
    for n in range(len(uv)):
        half = reach_px(sigma_px[n])
        left, top = int(np.rint(uv[n, 0])) - half, int(np.rint(uv[n, 1])) - half
        size = 2 * half + 1
        _share(left - uv[n, 0], sigma_px[n], size, across)
        _share(top - uv[n, 1], sigma_px[n], size, down)
        for i in range(max(0, -top), min(size, height - top)):
            row = top + i
            for j in range(max(0, -left), min(size, width - left)):
                column = left + j
                light[row, column] += (electrons[n] * down[i] * across[j]
                                       * response[row, column])


@compiled
def _share(first: float, sigma: float, size: int, share: np.ndarray) -> None:
    """Fill share with what falls into size pixels, the first with its centre at first."""
    scale = 1 / (sigma * math.sqrt(2.0))
    before = math.erf((first - 0.5) * scale)
    for i in range(size):
        after = math.erf((first + i + 0.5) * scale)
        share[i] = (after - before) / 2
        before = after
