"""One image made ready: filtered, its background known, its peaks listed."""

from dataclasses import dataclass

import numpy as np

from startracker_ros.centroid.background import measure_background, Mesh
from startracker_ros.centroid.detection import find_peaks, full_scale, smooth_image
from startracker_ros.centroid.gaussian_fit import FLUX, SIGMA, U, V
from startracker_ros.centroid.windows import cut_windows, Windows

RADIUS_SIGMAS = 3.5
MIN_RADIUS_PX = 3
RING_SIGMAS = 4.0  # around a peak it is dark again,
RING_LIGHT = 0.5  # less than this share of the peak in half of the directions
_ANGLES = np.arange(8) * np.pi / 4
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


@dataclass(frozen=True)
class Frame:
    """Image (H, W) float32, its Gaussian filtered copy and what was measured in them."""

    pixels: np.ndarray
    smooth: np.ndarray
    filter_sigma_px: float
    noise_gain: float
    mesh: Mesh
    full_scale_dn: float

    @property
    def background_dn(self) -> float:
        """Median level."""
        return float(np.median(self.mesh.level))

    @property
    def noise_dn(self) -> float:
        """Median noise of a pixel, 1 sigma."""
        return float(np.median(self.mesh.noise)) / self.noise_gain

    def peaks(self, threshold_sigma: float) -> tuple[np.ndarray, int]:
        """Return the peaks above threshold (N, 2) u, v, highest first, and the number left out.

        Left out are those within or on the rim of something bright and large, such as the
        Moon, whose noise would otherwise make more peaks than the sky has stars.
        """
        peaks = find_peaks(self.smooth, self.mesh.threshold(threshold_sigma))
        level = self.mesh.at(peaks)[0]
        height_dn = self.smooth[peaks[:, 1], peaks[:, 0]] - level
        last = np.array(self.smooth.shape[::-1]) - 1
        ring = peaks + np.rint(RING_SIGMAS * self.filter_sigma_px * _DIRECTIONS)[:, None]
        u, v = np.moveaxis(np.clip(ring, 0, last).astype(int), -1, 0)
        around_dn = np.median(self.smooth[v, u], axis=0) - level
        alone = around_dn < RING_LIGHT * height_dn
        order = np.argsort(-height_dn[alone], kind='stable')
        return peaks[alone][order], int((~alone).sum())

    def windows(self, peaks: np.ndarray, sigma_px: float) -> tuple[Windows, np.ndarray]:
        """Return windows for stars of this width at peaks (K, 2) and the start of their fit."""
        level, noise = self.mesh.at(peaks)
        radius = max(MIN_RADIUS_PX, int(np.ceil(RADIUS_SIGMAS * sigma_px)))
        start = np.zeros((len(peaks), 5))
        start[:, U] = peaks[:, 0] + self._shift(peaks, (1, 0))
        start[:, V] = peaks[:, 1] + self._shift(peaks, (0, 1))
        height_dn = self.smooth[peaks[:, 1], peaks[:, 0]] - level
        start[:, FLUX] = height_dn * 2 * np.pi * (self.filter_sigma_px ** 2 + sigma_px ** 2)
        start[:, SIGMA] = sigma_px
        return cut_windows(self.pixels, peaks, radius, level, (noise / self.noise_gain) ** 2,
                           self.full_scale_dn), start

    def _shift(self, peaks: np.ndarray, along: tuple[int, int]) -> np.ndarray:
        """Return how far (K,) px the top of a parabola through the peak and its neighbours is."""
        last = np.array(self.smooth.shape[::-1]) - 1
        before, here, after = (
            self.smooth[place[:, 1], place[:, 0]] for place in (
                np.maximum(peaks - along, 0), peaks, np.minimum(peaks + along, last)))
        bend = np.maximum(2 * here - before - after, 1e-6)
        return np.clip((after - before) / (2 * bend), -0.5, 0.5)


def prepare(image: np.ndarray, filter_sigma_px: float) -> Frame:
    """Return the frame of image (H, W) uint8 or uint16."""
    pixels = image.astype(np.float32)  # several times faster to filter than uint16
    smooth, noise_gain = smooth_image(pixels, filter_sigma_px)
    mesh = measure_background(smooth, noise_gain)
    return Frame(pixels, smooth, filter_sigma_px, noise_gain, mesh,
                 full_scale(image, float(np.median(mesh.level))))
