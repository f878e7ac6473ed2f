# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star image to centroids, with a reason for every spot left out: by the native library.

native/src/centroid/extraction.h tells the steps. Once an image was searched, search_near()
measures stars at known positions only.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.image_tracker import (
    Found, ImageTracker, METHODS, THRESHOLDS, WEIGHTS)
from startracker_ros.core.centroid.reasons import rejections, status_and_reason
from startracker_ros.core.centroid.streak import Streak
from startracker_ros.core.options import option, Options

CELL_SHARE = 4.0
"""Of its share of the spots, which each of 8 x 8 cells of an image may have."""


@dataclass(frozen=True)
class ExtractionOptions(Options):
    """Options of the centroid extraction."""

    threshold: str = option(
        'sigma', 'threshold of the pixels of a star: sigma: 3 times their noise; fixed: '
        'threshold_dn, for detection too; iterative: computed in the window of the star',
        choices=THRESHOLDS, live=True)
    threshold_sigma: float = option(
        5.5, 'detection threshold above the local background, in standard deviations of the '
        'filtered image',
        low=3.0, high=100.0, live=True)
    threshold_dn: float = option(
        50.0, 'fixed detection threshold above the local background', unit='DN', low=0.1,
        high=65535.0, live=True)
    method: str = option(
        'gaussian', 'gaussian: fit of the point spread function; others: mean of the pixels of '
        'a star with weight 1, flux, flux squared, flux above the threshold',
        choices=(*WEIGHTS, 'gaussian'), live=True)
    psf_sigma_px: float = option(
        0.0, 'width (1 sigma) of a star image, 0: estimated from each image',
        unit='px', low=0.0, high=5.0)
    max_stars: int = option(
        40, 'maximum number of stars, the brightest ones', low=1, high=5000, live=True)
    exposure_s: float = option(
        0.0, 'exposure time of the images; 0: that of exposure_start, else estimated from the '
        'length of streaks', unit='s', low=0.0, high=600.0)
    line_time_us: float = option(
        0.0, 'rolling shutter: delay from one row to the next; 0: global shutter', unit='us',
        low=0.0, high=10000.0)
    readout_direction: str = option(
        'down', 'rolling shutter: whether the rows further down (+v) or up are exposed later',
        choices=('down', 'up'))


@dataclass(frozen=True)
class Extraction:
    """
    Centroids of an image, its background and its rejected detections.

    Attributes:
        centroids: The stars (`Centroids`).
        status: 'ok', 'no_stars', 'blank', 'saturated', 'too_small' or 'too_many'.
        reason: The status in words, empty when ok.
        background_dn: Median background, DN; NaN where not measured.
        noise_dn: Median noise of a pixel, 1 sigma, DN; NaN where not measured.
        psf_sigma_px: Width (1 sigma) of the star images, px; NaN where not measured.
        rejected: Number of rejected detections by reason.
        rejected_uv: (R, 2) px, where they are.
        streak: Motion of the stars in the exposure (Streak), None for points.

    """

    centroids: Centroids
    status: str
    reason: str
    background_dn: float = float('nan')
    noise_dn: float = float('nan')
    psf_sigma_px: float = float('nan')
    rejected: dict[str, int] = field(default_factory=dict)
    rejected_uv: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    streak: Streak | None = None

    @property
    def streak_px(self) -> float:
        """Length of the streaks in the middle of the image, zero for points."""
        return 0.0 if self.streak is None else self.streak.length_px

    @classmethod
    def of(cls, found: Found) -> 'Extraction':
        """Return what the library found."""
        figures = found.figures
        status, reason = status_and_reason(figures)
        return cls(found.centroids, status, reason, figures['background_dn'], figures['noise_dn'],
                   figures['psf_sigma_px'], rejections(figures), found.rejected_uv, found.streak)


class Searched:
    """What a searched image leaves for those after it: background and width of the stars."""

    def __init__(self, image: np.ndarray, block: np.ndarray) -> None:
        self.block = block
        self._shape, self._dtype = image.shape, image.dtype

    def fits(self, image: np.ndarray) -> bool:
        """Return whether an image has the size and the type of the one that was searched."""
        return bool(self._shape == image.shape and self._dtype == image.dtype)


class CentroidExtractor:
    """
    Finds the stars of mono8 and mono16 images.

    measure() is a pure function of image and options. search() and search_near() are so too;
    what an image leaves for those after it is passed in and returned. One thread at a time.
    """

    def __init__(self, options: ExtractionOptions = ExtractionOptions(),
                 factor: float = 1.0) -> None:
        """Accept options, and a factor that falsifies the threshold of the weighted means."""
        self._options, self._factor = options, factor
        self._tracker: ImageTracker | None = None

    def measure(self, image: np.ndarray, streak: Streak | None = None, *,
                points_only: bool = False) -> Extraction:
        """Return the stars of image (H, W) as search() does, of an image without any before."""
        return self.search(image, streak, points_only=points_only)[0]

    def search(self, image: np.ndarray, streak: Streak | None = None,
               before: Searched | None = None, *, most_stars: int = 0,
               points_only: bool = False, narrow: bool = False
               ) -> tuple[Extraction, Searched | None]:
        """
        Return the stars of image (H, W) uint8 or uint16; ValueError for anything else.

        streak is the motion of the exposure where it is known, before the last image of this
        camera that was searched, most_stars the number of stars, 0 for that of the options.
        Only points are searched where points_only, and those of the narrowest spots where narrow
        too. The second result is `before` of the next image.
        """
        tracker = self._tracker_of(image)
        if before is not None and not before.fits(image):
            before = None
        after = Searched(image, tracker.searched())
        found, kept = tracker.search(
            image, streak, None if before is None else before.block, after.block, self._factor,
            most_stars, points_only, narrow)
        return Extraction.of(found), after if kept else before

    def search_near(self, image: np.ndarray, uv: np.ndarray, radius_px: np.ndarray,
                    before: Searched, streak: Streak | None = None
                    ) -> tuple[Extraction, Searched]:
        """
        Return the stars of image (H, W) within radius_px (K,) of predicted positions uv (K, 2).

        before is the last image that was searched, of the same size and type; it gives
        background and PSF sigma. What contaminated it is removed here too. The second result is
        `before` of the next image.
        """
        tracker = self._tracker_of(image)
        after = Searched(image, tracker.searched())
        found = tracker.search_near(image, uv, radius_px, streak, before.block, after.block)
        return Extraction.of(found), after

    def measure_widths(self, image: np.ndarray, searched: Searched, most: int
                       ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return uv (K, 2) and PSF sigma (K,) px of stars of a searched image, each fitted by itself.

        They are those of the highest peaks, at most so many.
        """
        found = self._tracker_of(image).measure_widths(image, searched.block, most)
        return found[:, :2], found[:, 2]

    def find_spots(self, image: np.ndarray, cell_share: float = CELL_SHARE, calm: bool = False
                   ) -> Centroids:
        """
        Return the connected spots of any shape of an image (H, W), at most 60, brightest first.

        No cell of the image gets more than cell_share of its share while others have any. Calm
        ones only: not those of trees, buildings and text, which are close together.
        """
        return self._tracker_of(image).find_spots(image, cell_share, calm)

    def find_highest_peaks(self, image: np.ndarray) -> Centroids:
        """Return the 30 peaks of an image (H, W) that stand out most, brightest first."""
        return self._tracker_of(image).find_highest_peaks(image)

    def full_scale(self, image: np.ndarray, background_dn: float) -> float:
        """Return the DN at which image (H, W) saturates, infinity when nothing in it does."""
        return self._tracker_of(image).full_scale(image, background_dn)

    def _tracker_of(self, image: np.ndarray) -> ImageTracker:
        """Return a tracker for an image; ValueError for what is not an image."""
        check_image(image)
        if self._tracker is None or not self._tracker.is_of(image):
            self._tracker = ImageTracker(image.shape, native_options(self._options))
        return self._tracker


def native_options(options: ExtractionOptions) -> dict[str, Any]:
    """Return the fields of st_extraction_options."""
    return {name: getattr(options, name) for name in (
        'threshold_sigma', 'threshold_dn', 'psf_sigma_px', 'exposure_s', 'line_time_us',
        'max_stars')} | {'threshold': THRESHOLDS.index(options.threshold),
                         'method': METHODS.index(options.method),
                         'readout_up': options.readout_direction == 'up'}


def check_image(image: np.ndarray) -> None:
    """Raise ValueError for what is not an image (H, W) uint8 or uint16."""
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        kind = image.dtype if isinstance(image, np.ndarray) else type(image).__name__
        raise ValueError(f'image is {kind}, must be uint8 or uint16')
    if image.ndim != 2:
        raise ValueError(f'image has {image.ndim} dimensions, must have 2 (grey)')
    if not image.size:
        raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px is empty')
