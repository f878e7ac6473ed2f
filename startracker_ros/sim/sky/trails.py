# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trails of satellites and aircraft: straight lines across the whole image."""

import math

import numpy as np
from startracker_ros.core.compiled import compiled

_REACH = 5
"""In sigma, as of stars."""


@compiled
def add_trails(trails: np.ndarray, peak_e: float, sigma_px: float, response: np.ndarray,
               light: np.ndarray) -> None:
    """
    Add trails (N, 4), u, v, du, dv of a point and a unit direction, to light (H, W) float32.

    At distance d from the centre line a pixel gets peak_e sigma / s exp(-d^2 / (2 s^2)), with
    s^2 = sigma^2 + 1/12: the Gaussian widened by the pixel, its flux across the trail kept.
    response (H, W) float32 is the sensitivity of each pixel.
    """
    height, width = light.shape
    s = math.sqrt(sigma_px ** 2 + 1 / 12)
    reach = _REACH * s
    for n in range(len(trails)):
        u, v, du, dv = trails[n]
        for row in range(height):
            # Distance of pixel (column, row): |dv (column - u) - du (row - v)|.
            across = du * (row - v)
            first, last = 0, width - 1
            if abs(dv) * width > 1e-9:
                middle, half = u + across / dv, reach / abs(dv)
                first = int(max(0.0, min(math.ceil(middle - half), float(width))))
                last = int(min(width - 1.0, max(math.floor(middle + half), -1.0)))
            elif abs(across) > reach:
                continue
            for column in range(first, last + 1):
                d = dv * (column - u) - across
                light[row, column] += (peak_e * sigma_px / s * math.exp(-d * d / (2 * s * s))
                                       * response[row, column])
