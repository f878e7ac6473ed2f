# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The lists of stars of a photograph, which are tried in turn.

The extractor (extraction.py) gives one list for a star tracker, which has one try. Whoever solves
a photograph has the time to try others.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from itertools import islice

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids, ROUND
from startracker_ros.core.centroid.extraction import CentroidExtractor

LISTS = 4
FEW_LISTS = 2
"""Lists of an image at most that are searched for few stars."""
_SPREAD_SHARE = 2.0  # of spots that are spread over the image
_SAME_PX = 1.5  # a fitted position this close to the centre of the flux is of the same star
_NO_SKY = 'blank', 'saturated', 'too_small'
_BINNED_SIDE_PX = 128  # least side of an image that is searched at half its resolution too


class Detections:
    """
    The stars of an image (H, W) uint8 or uint16 in up to four lists, each brightest first.

    The lists differ in what counts as a star: a fitted point; any spot; any spot of the image at
    half its resolution, which has no colour mosaic and less noise, in calm surroundings and spread
    over the image; a fitted point of any width or streak. Each is made when it is first needed;
    lists without stars are left out. extraction is that of the last list, once it is made, else of
    the first. Spots at the places fixed (F, 2) px are left out.
    """

    def __init__(self, image: np.ndarray, fixed: np.ndarray | None = None) -> None:
        self._image = image
        self._fixed = np.empty((0, 2)) if fixed is None else fixed
        self._extractor = CentroidExtractor()
        self._points = self._extractor.measure(image, points_only=True)
        self.extraction = self._points
        self._lists = [self._moving(self.extraction.centroids)]

    def __iter__(self) -> Iterator[Centroids]:
        """Yield the lists that have stars."""
        for index in range(LISTS):
            if index == len(self._lists):
                self._lists.append(self._moving(self._spots_of(index)))
            if len(self._lists[index]):
                yield self._lists[index]

    @cached_property
    def peaks(self) -> Centroids:
        """
        Return the peaks that stand out most, whatever they are.

        A search whose probability of chance counts all spots needs no threshold, which keeps out
        the faint stars of a noisy or coarsely quantised image.
        """
        if self._points.status in _NO_SKY:
            return Centroids.empty()
        return self._moving(self._extractor.find_highest_peaks(self._image))

    def _moving(self, spots: Centroids) -> Centroids:
        """Return the spots that are not at fixed places."""
        if not len(self._fixed):
            return spots
        apart = np.linalg.norm(spots.uv[:, None] - self._fixed, axis=2)
        return spots.select(apart.min(axis=1) > _SAME_PX)

    def _spots_of(self, index: int) -> Centroids:
        image = self._image
        if self._points.status in _NO_SKY:
            return Centroids.empty()
        if index == 1:
            return _fitted_where_close(
                self._extractor.find_spots(image), self._points.centroids)
        if index == 3:
            self.extraction = self._extractor.measure(image)
            return self.extraction.centroids
        if min(image.shape) < _BINNED_SIDE_PX:
            return Centroids.empty()
        return _spots_at_half_resolution(image)


def points_and_peaks(lists: Iterable[Centroids]) -> Iterator[Centroids]:
    """Yield two lists of an image, the fastest first; of others their first two."""
    yield from islice(lists, 1 if isinstance(lists, Detections) else FEW_LISTS)
    if isinstance(lists, Detections) and len(lists.peaks):
        yield lists.peaks


def few_star_lists(lists: Iterable[Centroids]) -> Iterator[Centroids]:
    """Yield the lists that are searched for few stars: of an image its peaks and its spots."""
    if isinstance(lists, Detections) and len(lists.peaks):
        yield lists.peaks
    yield from islice(lists, 1 if isinstance(lists, Detections) else 0, FEW_LISTS)


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


def _spots_at_half_resolution(image: np.ndarray) -> Centroids:
    """Return the spots of an image binned 2 x 2, in pixels of the whole image."""
    height, width = (side // 2 * 2 for side in image.shape)
    blocks = image[:height, :width].reshape(height // 2, 2, width // 2, 2)
    # The sum of four, halved: the depth of the pixels stays, and so does most of the precision.
    binned = (blocks.sum((1, 3), dtype=np.uint32) // 2).astype(np.uint16)
    # Where all stars are saturated, those of the blurred side of a wide lens seem the brightest.
    spots = CentroidExtractor().find_spots(binned, _SPREAD_SHARE, calm=True)
    return replace(spots, uv=2 * spots.uv + 0.5, sigma_px=2 * spots.sigma_px,
                   covariance=ROUND)
