# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One image with its background and its peaks."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.centroid.background import (
    has_changed, measure_background, Mesh, pixel_noise)
from startracker_ros.core.centroid.detection import find_peaks, full_scale, Search, Threshold
from startracker_ros.core.centroid.smoothing import gaussian_kernel, Kernel


@dataclass(frozen=True)
class Frame:
    """
    Image (H, W) uint16, the matched filter of its stars, its background and its peaks.

    bits is the depth of the pixels as they came, 8 or 16.
    """

    image: np.ndarray
    kernel: Kernel
    mesh: Mesh
    search: Search
    full_scale_dn: float
    bits: int

    @property
    def background_dn(self) -> float:
        """Median level."""
        return self.mesh.median_level

    @property
    def noise_dn(self) -> float:
        """Median noise of a pixel, 1 sigma."""
        return self.mesh.median_noise / self.kernel.noise_gain

    @property
    def blank(self) -> bool:
        """Whether all pixels are equal."""
        row_max = self.search.row_max
        return bool(row_max.min() == row_max.max() and (self.image == row_max[0]).all())

    @property
    def saturated(self) -> bool:
        """Whether most pixels are at full scale."""
        rows = self.image[self.search.row_max == self.full_scale_dn]
        return bool(2 * np.count_nonzero(rows == self.full_scale_dn) > self.image.size)

    def followed_by(self, image: np.ndarray, uv: np.ndarray, hits: bool) -> 'Frame':
        """Return the frame of a later image (H, W) with stars near uv (K, 2); see prepare()."""
        changed = has_changed(self.mesh, image, uv, self.noise_dn)
        mesh = _mesh(image, self.kernel, hits) if changed else self.mesh
        return Frame(image, self.kernel, mesh, self.search, self.full_scale_dn, self.bits)


def prepare(image: np.ndarray, filter_sigma_px: float, threshold: Threshold,
            bits: int, hits: bool = False) -> Frame:
    """
    Return the frame of image (H, W) uint16 with a filter of this PSF sigma.

    bits is the depth of the pixels as they came; hits is whether the image had hits on so many
    pixels that they count in the noise after the filter.
    """
    kernel = gaussian_kernel(filter_sigma_px)
    mesh = _mesh(image, kernel, hits)
    search = find_peaks(image, kernel, mesh, threshold)
    return Frame(image, kernel, mesh, search,
                 full_scale(image, search.row_max, mesh.median_level, bits), bits)


def _mesh(image: np.ndarray, kernel: Kernel, hits: bool) -> Mesh:
    mesh = measure_background(image, kernel)
    if not hits:
        return mesh
    return mesh.scaled(pixel_noise(image) * kernel.noise_gain / mesh.median_noise)
