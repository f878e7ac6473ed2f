"""
Detection in photographs: all light above the background, whatever its shape.

The extractor for the flight (extraction.py) fits a point or a streak and rejects what has another
shape. In a photograph the stars themselves have other shapes: coma, trails, colour mosaics,
compression. Here every connected spot of the smoothed image above the threshold is a star, the
brightest ones first, unless it is as large as a cloud or a building. Its position is the centre
of its light, with an error that follows its size; where the extractor has fitted a star in the
spot, its position and error are used.
"""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from startracker_ros.core.centroid.background import measure_background, over_image
from startracker_ros.core.centroid.centroids import Centroids, ROUND
from startracker_ros.core.centroid.connected import connected_spots
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.centroid.quota import brightest
from startracker_ros.core.centroid.smoothing import gaussian_kernel

MAX_STARS = 60
LISTS = 4
_FILTER_SIGMA_PX = 1.0
_THRESHOLD_SIGMAS = 5.0
# Least height above the background: quantised and clipped backgrounds have no noise to measure.
_LEAST_DN = 1.5
_MAX_SIDE_PX = 30.0  # of a spot, in an image of 1024 px; no star is as large
_REFERENCE_PX = 1024
_SAME_PX = 1.5  # a fitted position this close to the centre of the light is of the same star
_BINNED_SIDE_PX = 128  # least side of an image that is searched at half its resolution too
_SIZE_SHARE = 0.1  # of the size of a spot that its centre is off, beyond noise


class Detections:
    """
    The stars of an image (H, W) uint8 or uint16 in up to four lists, each brightest first.

    The lists differ in what counts as a star: a fitted point; any spot; any spot of the image at
    half its resolution, which has no colour mosaic and less noise; a fitted point of any width or
    streak. Each is made when it is first needed; lists without stars are left out. extraction is
    that of the last list, once it is made, else of the first.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._image = image
        self._points = CentroidExtractor().extract(image, points_only=True)
        self.extraction = self._points
        self._lists = [self.extraction.centroids]

    def __iter__(self) -> Iterator[Centroids]:
        """Yield the lists that have stars."""
        for index in range(LISTS):
            if index == len(self._lists):
                self._lists.append(self._spots_of(index))
            if len(self._lists[index]):
                yield self._lists[index]

    def _spots_of(self, index: int) -> Centroids:
        image = self._image
        if self._points.status in ('blank', 'saturated', 'too_small'):
            return Centroids.empty()
        if index == 1:
            return _fitted_where_close(_spots(image), self._points.centroids)
        if index == 3:
            self.extraction = CentroidExtractor().extract(image)
            return self.extraction.centroids
        if min(image.shape) < _BINNED_SIDE_PX:
            return Centroids.empty()
        return _spots_at_half_resolution(image)


def _spots_at_half_resolution(image: np.ndarray) -> Centroids:
    """Return the spots of an image binned 2 x 2, in pixels of the whole image."""
    height, width = (side // 2 * 2 for side in image.shape)
    blocks = image[:height, :width].reshape(height // 2, 2, width // 2, 2)
    # The sum of four, halved: the depth of the pixels stays, and so does most of the precision.
    binned = (blocks.sum((1, 3), dtype=np.uint32) // 2).astype(np.uint16)
    spots = _spots(binned)
    return replace(spots, uv=2 * spots.uv + 0.5, sigma_px=2 * spots.sigma_px,
                   covariance=ROUND)


def _spots(image: np.ndarray) -> Centroids:
    """Return the connected spots of an image (H, W), the brightest first."""
    height, width = image.shape
    mesh = measure_background(image, gaussian_kernel(_FILTER_SIGMA_PX))
    light = image.astype(np.float32)
    light -= over_image(mesh.level, image.shape)
    smooth = cv2.GaussianBlur(light, (0, 0), _FILTER_SIGMA_PX)
    threshold = over_image(np.maximum(_THRESHOLD_SIGMAS * mesh.noise, _LEAST_DN), image.shape)
    pixel = np.flatnonzero(smooth > threshold)
    v, u = np.divmod(pixel, width)
    spot, count = connected_spots(u, v, width, height)
    light, noise = smooth.ravel()[pixel].astype(float), threshold.ravel()[pixel]
    largest = _MAX_SIDE_PX * max(1.0, max(image.shape) / _REFERENCE_PX)
    total = np.bincount(spot, light, count)
    chosen = np.flatnonzero(_sides(spot, count, u, v) <= largest)
    centre = np.stack([np.bincount(spot, light * x, count) / total for x in (u, v)], -1)
    chosen = chosen[np.argsort(-total[chosen], kind='stable')]
    # Letters and lit windows are bright and close together.
    chosen = chosen[brightest(centre[chosen], image.shape, MAX_STARS)]
    square = np.bincount(spot, light * ((u - centre[spot, 0]) ** 2
                                        + (v - centre[spot, 1]) ** 2), count) / total / 2
    size = np.sqrt(square + 1 / 12)
    variance = np.bincount(spot, (noise / _THRESHOLD_SIGMAS) ** 2, count)
    snr = total / np.sqrt(variance)
    sigma_px = np.hypot(size / np.maximum(snr, 1), _SIZE_SHARE * size)
    return Centroids(centre[chosen], total[chosen], snr[chosen], sigma_px[chosen])


def _sides(spot: np.ndarray, count: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the longer side (count,) in px of each spot, of pixels u, v of spot (N,)."""
    longer = np.zeros(count)
    for x in (u, v):
        low, high = np.full(count, x.max(initial=0)), np.zeros(count, int)
        np.minimum.at(low, spot, x)
        np.maximum.at(high, spot, x)
        longer = np.maximum(longer, high - low + 1)
    return longer


def _fitted_where_close(spots: Centroids, fitted: Centroids) -> Centroids:
    """Return the spots, with position and error of the fitted stars at their centres."""
    if not len(fitted):
        return spots
    distance = np.linalg.norm(spots.uv[:, None] - fitted.uv, axis=-1)
    nearest = distance.argmin(axis=1)
    same = distance[np.arange(len(spots)), nearest] < _SAME_PX
    uv, sigma_px = spots.uv.copy(), spots.sigma_px.copy()
    uv[same], sigma_px[same] = fitted.uv[nearest[same]], fitted.sigma_px[nearest[same]]
    return Centroids(uv, spots.flux, spots.snr, sigma_px)
