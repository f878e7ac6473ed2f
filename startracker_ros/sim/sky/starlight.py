# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Point sources on a sensor: a Gaussian integrated over square pixels."""

import math

import numpy as np
from startracker_ros.core.compiled import compiled

_REACH = 5
"""In sigma. Cutting the rest, 6e-7 of the light, shifts a centroid by less than 2e-6 sigma."""


@compiled
def reach_px(sigma_px: float) -> int:
    """Return the radius in px of the image of a source of width sigma_px."""
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
        _pixel_fractions(left - uv[n, 0], sigma_px[n], size, across)
        _pixel_fractions(top - uv[n, 1], sigma_px[n], size, down)
        for i in range(max(0, -top), min(size, height - top)):
            row = top + i
            for j in range(max(0, -left), min(size, width - left)):
                column = left + j
                light[row, column] += (electrons[n] * down[i] * across[j]
                                       * response[row, column])


@compiled
def _pixel_fractions(first: float, sigma: float, size: int, fraction: np.ndarray) -> None:
    """
    Fill fraction with the integral of a unit Gaussian at 0 over each of size pixels.

    Pixel i spans x_i - 1/2 to x_i + 1/2 with x_i = first + i; its fraction is
    (erf((x_i + 1/2) / (sigma sqrt 2)) - erf((x_i - 1/2) / (sigma sqrt 2))) / 2.
    """
    scale = 1 / (sigma * math.sqrt(2.0))
    lower = math.erf((first - 0.5) * scale)
    for i in range(size):
        upper = math.erf((first + i + 0.5) * scale)
        fraction[i] = (upper - lower) / 2
        lower = upper
