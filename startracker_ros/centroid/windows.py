"""Square cut-outs around the peaks, and the light that neighbours throw into them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Windows:
    """K windows of n x n pixels, rows v and columns u.

    data (K, n, n) float64 DN above the mesh background; used (K, n, n) bool, False outside
    the image and where saturated; corner (K, 2) int, u and v of the first pixel;
    variance (K,) DN^2 of one background pixel; neighbours (P, 2) int, pairs (i, j) where star
    j throws light into window i.
    """

    data: np.ndarray
    used: np.ndarray
    corner: np.ndarray
    variance: np.ndarray
    neighbours: np.ndarray

    def __len__(self) -> int:
        return len(self.data)

    @property
    def radius(self) -> int:
        """Pixels on each side of the peak."""
        return self.data.shape[1] // 2

    def select(self, chosen: np.ndarray) -> 'Windows':
        """Return the windows of chosen (K,) bool; light of stars not chosen is forgotten."""
        number = np.cumsum(chosen) - 1
        pairs = self.neighbours[chosen[self.neighbours].all(1)]
        return Windows(self.data[chosen], self.used[chosen], self.corner[chosen],
                       self.variance[chosen], number[pairs])


def cut_windows(image: np.ndarray, peaks: np.ndarray, radius: int, level: np.ndarray,
                variance: np.ndarray, full_scale: float) -> Windows:
    """Return the windows of image (H, W) around peaks (K, 2) u, v; level and variance (K,)."""
    offset = np.arange(-radius, radius + 1)
    u, v = peaks[:, :1] + offset, peaks[:, 1:] + offset
    height, width = image.shape
    data = image[np.clip(v, 0, height - 1)[:, :, None], np.clip(u, 0, width - 1)[:, None, :]]
    inside = (((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :])
    pairs = cKDTree(peaks).query_pairs(2 * radius, p=np.inf, output_type='ndarray')
    return Windows(data - level[:, None, None], inside & (data < full_scale), peaks - radius,
                   variance, np.concatenate([pairs, pairs[:, ::-1]]))
