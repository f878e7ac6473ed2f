# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Square cut-outs around the peaks, and which of them share flux."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.background import Mesh, slope_at
from startracker_ros.core.compiled import compiled

LANES = 8  # pixels processed at a time
CORE_RADIUS_PX = 2


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

    @property
    def radius(self) -> int:
        """Pixels on each side of the peak."""
        return self.data.shape[1] // 2

    def select(self, chosen: np.ndarray) -> 'Windows':
        """Return the windows of chosen (K,) bool; other stars no longer count as neighbours."""
        if chosen.all():
            return self
        corner = self.corner[chosen]
        return Windows(self.data[chosen], self.used[chosen], corner, self.variance[chosen],
                       *_neighbours(corner, self.data.shape[1]))

    def saturated_cores(self) -> np.ndarray:
        """Return the number (K,) of unused pixels within CORE_RADIUS_PX of the peaks."""
        return _count_unused(self.used, CORE_RADIUS_PX)


def cut_windows(image: np.ndarray, mesh: Mesh, uv: np.ndarray, radius: int, level: np.ndarray,
                variance: np.ndarray, full_scale: float) -> Windows:
    """
    Return the windows of image (H, W) around peaks uv (K, 2); level and variance (K,) are there.

    The slope of the background, which would move a star towards the brighter side, is that of the
    mesh.
    """
    data, used = _cut(image, mesh, uv, radius, level, full_scale)
    corner = uv - radius
    return Windows(data, used, corner, variance, *_neighbours(corner, 2 * radius + 1))


@compiled
def _cut(image: np.ndarray, mesh: Mesh, uv: np.ndarray, radius: int, level: np.ndarray,
         full_scale: float) -> tuple[np.ndarray, np.ndarray]:
    height, width = image.shape
    count = 2 * radius + 1
    filled = (count + LANES - 1) // LANES * LANES
    data = np.zeros((len(uv), count, filled), np.float32)
    used = np.zeros((len(uv), count, filled), np.bool_)
    for i in range(len(uv)):
        u, v = uv[i, 0], uv[i, 1]
        left, top = u - radius, v - radius
        across, down = slope_at(mesh, u, v, radius)
        for y in range(max(-top, 0), min(height - top, count)):
            for x in range(max(-left, 0), min(width - left, count)):
                value = image[top + y, left + x]
                data[i, y, x] = value - level[i] - across * (x - radius) - down * (y - radius)
                used[i, y, x] = value < full_scale
    return data, used


@compiled
def _count_unused(used: np.ndarray, radius: int) -> np.ndarray:
    """Return the number (K,) of pixels not used within radius of the middle of used (K, n, n)."""
    middle, count = used.shape[1] // 2, np.zeros(len(used), np.int64)
    for i in range(len(used)):
        for y in range(middle - radius, middle + radius + 1):
            for x in range(middle - radius, middle + radius + 1):
                count[i] += not used[i, y, x]
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
