# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Peaks near predicted positions: no search of the whole image."""

import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh
from startracker_ros.core.centroid.detection import empty_peaks, parabola_top, Peaks, Threshold
from startracker_ros.core.centroid.hits import are_sharper
from startracker_ros.core.centroid.smoothing import filtered_at, Kernel
from startracker_ros.core.compiled import compiled

HIT_SHARE = 0.1  # of the peaks near predicted stars, from which on hits are taken out


@compiled
def peaks_near(image: np.ndarray, kernel: Kernel, mesh: Mesh, threshold: Threshold,
               uv: np.ndarray, radius_px: np.ndarray, share: float
               ) -> tuple[Peaks, np.ndarray, bool]:
    """
    Return peaks within radius_px (K,) of positions uv (K, 2), and which positions (K,) have one.

    The highest value must exceed the threshold and the pixels around it, and no two positions
    share one. The last result is whether some of the peaks are hits, by the least share of
    hits.py.
    """
    height, width = image.shape
    peaks, found = empty_peaks(len(uv)), np.zeros(len(uv), np.bool_)
    around, count = np.empty((3, 3)), 0
    for i in range(len(uv)):
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
        found[i] = highest <= best
        for j in range(count):
            if peaks.uv[j, 0] == best_u and peaks.uv[j, 1] == best_v:
                found[i] = False
        if found[i]:
            peaks.uv[count, 0], peaks.uv[count, 1] = best_u, best_v
            peaks.top[count, 0] = parabola_top(around[1, 0], best, around[1, 2])
            peaks.top[count, 1] = parabola_top(around[0, 1], best, around[2, 1])
            peaks.height[count], peaks.level[count] = best - level, level
            peaks.noise[count] = noise
            count += 1
    peaks = Peaks(peaks.uv[:count], peaks.top[:count], peaks.height[:count], peaks.level[:count],
                  peaks.noise[:count])
    hit = are_sharper(image, peaks.uv, peaks.level, peaks.noise / kernel.noise_gain, share)
    return peaks, found, bool(np.count_nonzero(hit) > HIT_SHARE * count)


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
    if not (left >= radius and right < width - radius
            and top >= radius and bottom < height - radius):
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                value = filtered_at(image, weights, u, v)
                if value > best:
                    best, best_u, best_v = value, u, v
        return best, best_u, best_v
    # The taps are the outer loop: pixels side by side are added at once.
    rows, columns = bottom - top + 1, right - left + 1
    across, line = np.zeros((rows + 2 * radius, columns)), np.empty(columns)
    for y in range(rows + 2 * radius):
        for k in range(-radius, radius + 1):
            weight, row = weights[abs(k)], image[top - radius + y, left + k:right + k + 1]
            for x in range(columns):
                across[y, x] += weight * row[x]
    for y in range(rows):
        line[:] = 0
        for k in range(2 * radius + 1):
            weight = weights[abs(k - radius)]
            for x in range(columns):
                line[x] += weight * across[y + k, x]
        for x in range(columns):
            if line[x] > best:
                best, best_u, best_v = line[x], left + x, top + y
    return best, best_u, best_v
