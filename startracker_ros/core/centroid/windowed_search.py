# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Peaks near predicted positions: no search of the whole image."""

import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh
from startracker_ros.core.centroid.detection import empty_peaks, parabola_top, Peaks, Threshold
from startracker_ros.core.centroid.smoothing import filtered_at, Kernel
from startracker_ros.core.compiled import compiled


def peaks_near(image: np.ndarray, kernel: Kernel, mesh: Mesh, threshold: Threshold,
               uv: np.ndarray, radius_px: np.ndarray) -> tuple[Peaks, np.ndarray]:
    """
    Return peaks within radius_px (K,) of positions uv (K, 2), and which positions (K,) have one.

    The highest value must exceed the threshold and the pixels around it, and no two positions
    share one.
    """
    peaks, found = _peaks_near(image, kernel, mesh, threshold, uv, radius_px)
    return peaks.select(found), found


@compiled
def _peaks_near(image: np.ndarray, kernel: Kernel, mesh: Mesh, threshold: Threshold,
                uv: np.ndarray, radius_px: np.ndarray) -> tuple[Peaks, np.ndarray]:
    height, width = image.shape
    count = len(uv)
    peaks, good = empty_peaks(count), np.zeros(count, np.bool_)
    around = np.empty((3, 3))
    for i in range(count):
        left, right = int(np.ceil(uv[i, 0] - radius_px[i])), int(uv[i, 0] + radius_px[i])
        top, bottom = int(np.ceil(uv[i, 1] - radius_px[i])), int(uv[i, 1] + radius_px[i])
        best, best_u, best_v = _highest(image, kernel.weights, max(left, 1), max(top, 1),
                                        min(right, width - 2), min(bottom, height - 2))
        if best_u < 0:
            continue
        level, noise = background_at(mesh, best_u, best_v)
        if best - level < max(threshold.sigmas * noise, threshold.dn):
            continue
        highest = -np.inf
        for y in range(3):
            for x in range(3):
                around[y, x] = filtered_at(image, kernel.weights, best_u + x - 1, best_v + y - 1)
                highest = max(highest, around[y, x])
        good[i] = highest <= best
        for j in range(i):
            if good[j] and peaks.uv[j, 0] == best_u and peaks.uv[j, 1] == best_v:
                good[i] = False
        peaks.uv[i, 0], peaks.uv[i, 1] = best_u, best_v
        peaks.top[i, 0] = parabola_top(around[1, 0], best, around[1, 2])
        peaks.top[i, 1] = parabola_top(around[0, 1], best, around[2, 1])
        peaks.height[i], peaks.level[i], peaks.noise[i] = best - level, level, noise
    return peaks, good


@compiled
def _highest(image: np.ndarray, weights: np.ndarray, left: int, top: int, right: int, bottom: int
             ) -> tuple[float, int, int]:
    """
    Return the highest value of the filtered image from left, top to right, bottom, and its u, v.

    Each row is filtered once, as filtered_at() does it; u is -1 where there is no pixel.
    """
    height, width = image.shape
    radius = len(weights) - 1
    best, best_u, best_v = -np.inf, -1, -1
    if left > right or top > bottom:
        return best, best_u, best_v
    inside = (left >= radius and right < width - radius
              and top >= radius and bottom < height - radius)
    across = np.zeros((bottom - top + 1 + 2 * radius, right - left + 1))
    if inside:
        for y in range(across.shape[0]):
            row = image[np.uintp(top - radius + y)]
            for x in range(across.shape[1]):
                first = np.uintp(left + x - radius)
                for k in range(2 * radius + 1):
                    across[y, x] += weights[abs(k - radius)] * row[first + np.uintp(k)]
    for v in range(top, bottom + 1):
        for u in range(left, right + 1):
            value = 0.0
            if inside:
                for k in range(2 * radius + 1):
                    value += weights[abs(k - radius)] * across[v - top + k, u - left]
            else:
                value = filtered_at(image, weights, u, v)
            if value > best:
                best, best_u, best_v = value, u, v
    return best, best_u, best_v
