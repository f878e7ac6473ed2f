# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One image with its background and its peaks."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.centroid.background import (
    has_changed, measure_background, Mesh, pixel_noise)
from startracker_ros.core.centroid.detection import (
    find_peaks, full_scale, Peaks, Search, Threshold)
from startracker_ros.core.centroid.psf import FLUX, SIGMA, U, V
from startracker_ros.core.centroid.smoothing import gaussian_kernel, Kernel
from startracker_ros.core.centroid.windows import cut_windows, Windows

RADIUS_SIGMAS = 3.5
MIN_RADIUS_PX = 3


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
        if has_changed(self.mesh, image, uv, self.noise_dn):
            return replace(self, image=image, mesh=_mesh(image, self.kernel, hits))
        return replace(self, image=image)

    def windows(self, peaks: Peaks, sigma_px: float) -> tuple[Windows, np.ndarray]:
        """Return windows for stars of this PSF sigma at K peaks, and initial parameters (K, 5)."""
        radius = max(MIN_RADIUS_PX, int(np.ceil(RADIUS_SIGMAS * sigma_px)))
        start = np.zeros((len(peaks.uv), 5))
        start[:, [U, V]] = peaks.uv + peaks.top
        start[:, FLUX] = peaks.height * 2 * np.pi * (self.kernel.sigma_px ** 2 + sigma_px ** 2)
        start[:, SIGMA] = sigma_px
        return cut_windows(self.image, self.mesh, peaks.uv, radius, peaks.level,
                           (peaks.noise / self.kernel.noise_gain) ** 2,
                           self.full_scale_dn), start


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
