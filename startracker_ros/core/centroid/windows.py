# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Square cut-outs around the peaks, and which of them share flux."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.background import Mesh, slope_at
from startracker_ros.core.centroid.detection import Peaks
from startracker_ros.core.centroid.psf import FLUX, SIGMA, U, V
from startracker_ros.core.centroid.smoothing import Kernel
from startracker_ros.core.compiled import compiled

LANES = 8  # pixels processed at a time
CORE_RADIUS_PX = 2
RADIUS_SIGMAS = 3.5
MIN_RADIUS_PX = 3


class Windows(NamedTuple):
    """
    K windows of n x n pixels, rows v and columns u; their rows are filled up to m pixels.

    m is a multiple of LANES. data (K, n, m) float32 DN above the mesh background; used
    (K, n, m) bool, False outside the image or the window and where saturated; corner (K, 2)
    int, u and v of the first pixel; variance (K,) DN^2 of one background pixel. Stars
    sources[first[i]:first[i + 1]] have flux in window i; first (K + 1,) int.
    """

    data: np.ndarray
    used: np.ndarray
    corner: np.ndarray
    variance: np.ndarray
    first: np.ndarray
    sources: np.ndarray


@compiled
def cut_windows(image: np.ndarray, mesh: Mesh, kernel: Kernel, full_scale: float, peaks: Peaks,
                chosen: np.ndarray, sigma_px: float) -> Windows:
    """
    Return the windows of image (H, W) for stars of this PSF sigma at the chosen peaks (K,) int.

    The slope of the background, which would move a star towards the brighter side, is that of the
    mesh. full_scale in DN is the value from which on pixels are saturated.
    """
    (height, width), radius = image.shape, max(MIN_RADIUS_PX, math.ceil(RADIUS_SIGMAS * sigma_px))
    stars, count = len(chosen), 2 * radius + 1
    filled = (count + LANES - 1) // LANES * LANES
    data = np.zeros((stars, count, filled), np.float32)
    used = np.zeros((stars, count, filled), np.bool_)
    corner, variance = np.empty((stars, 2), np.int64), np.empty(stars)
    for i in range(stars):
        u, v = peaks.uv[chosen[i], 0], peaks.uv[chosen[i], 1]
        left, top, level = u - radius, v - radius, peaks.level[chosen[i]]
        corner[i, 0], corner[i, 1] = left, top
        variance[i] = (peaks.noise[chosen[i]] / kernel.noise_gain) ** 2
        across, down = slope_at(mesh, u, v, radius)
        for y in range(max(-top, 0), min(height - top, count)):
            for x in range(max(-left, 0), min(width - left, count)):
                value = image[top + y, left + x]
                data[i, y, x] = value - level - across * (x - radius) - down * (y - radius)
                used[i, y, x] = value < full_scale
    first, sources = _neighbours(corner, count)
    return Windows(data, used, corner, variance, first, sources)


@compiled
def initial_stars(kernel: Kernel, peaks: Peaks, chosen: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return initial parameters (K, 5) of stars of this PSF sigma at the chosen peaks (K,) int."""
    start = np.zeros((len(chosen), 5))
    area = 2 * np.pi * (kernel.sigma_px ** 2 + sigma_px ** 2)
    for i in range(len(chosen)):
        start[i, U] = peaks.uv[chosen[i], 0] + peaks.top[chosen[i], 0]
        start[i, V] = peaks.uv[chosen[i], 1] + peaks.top[chosen[i], 1]
        start[i, FLUX], start[i, SIGMA] = peaks.height[chosen[i]] * area, sigma_px
    return start


@compiled
def saturated_core(windows: Windows, i: int) -> int:
    """Return the number of unused pixels within CORE_RADIUS_PX of the peak of window i."""
    middle, count = windows.data.shape[1] // 2, 0
    for y in range(middle - CORE_RADIUS_PX, middle + CORE_RADIUS_PX + 1):
        for x in range(middle - CORE_RADIUS_PX, middle + CORE_RADIUS_PX + 1):
            count += not windows.used[i, y, x]
    return count


@compiled
def _neighbours(corner: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first (K + 1,) and sources: stars whose peaks are less than `count` px away."""
    order = np.argsort(corner[:, 1])
    first, slot = np.zeros(len(corner) + 1, np.int64), np.zeros(len(corner), np.int64)
    sources = np.empty(0, np.int64)
    for filling in (False, True):
        for a in range(len(order)):
            for b in range(a + 1, len(order)):
                i, j = order[a], order[b]
                if corner[j, 1] - corner[i, 1] >= count:
                    break
                if abs(corner[j, 0] - corner[i, 0]) < count:
                    if filling:
                        sources[slot[i]], sources[slot[j]] = j, i
                    slot[i] += 1
                    slot[j] += 1
        if not filling:
            first[1:] = np.cumsum(slot)
            slot[:] = first[:-1]
            sources = np.empty(first[-1], np.int64)
    return first, sources
