# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A tracker of the native library that extracts stars, and its results in Python."""

from collections.abc import Mapping
import ctypes
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.centroid.streak import Streak
from startracker_ros.core.native import address_of, aligned, NativeTracker

THRESHOLDS = ('sigma', 'fixed', 'iterative')
WEIGHTS = ('binary', 'grey', 'squared', 'thresholded')
METHODS = ('gaussian', *WEIGHTS)
KINDS = ('edge', 'saturated', 'hot_pixel', 'cosmic_ray', 'elongated', 'too_wide', 'not_fitted',
         'faint', 'not_streaked', 'disc', 'line')
"""Names of st_threshold, st_centroid_method and st_rejection, in their order."""

_EXTRACTS = 1  # ST_EXTRACTS
_MOST = 5000  # the largest capacity of predictions and centroids
_NAMES = native.EXTRACTION.names or ()


UNKNOWN = {'exposure_least_s': 0.0, 'exposure_most_s': np.inf}
"""Figures of centroids that are of no image."""


class Found(NamedTuple):
    """What was found in an image: figures of the EXTRACTION by its names, and its lists."""

    figures: dict[str, Any]
    centroids: Centroids
    rejected_uv: np.ndarray

    @property
    def streak(self) -> Streak | None:
        """Return the motion fitted with, None for points."""
        found = Streak(*(self.figures[f'streak_{name}'] for name in (
            'u_px', 'v_px', 'roll_rad', 'at_u_px', 'at_v_px')))
        return None if np.isnan(found.u_px) else found


class ImageTracker:
    """
    A tracker for images of a camera, (H, W), in memory of its own; one thread uses it at a time.

    options are the fields of st_extraction_options. tracker is one that also does other things
    with the images of that camera. ValueError for a camera that is too large.
    """

    def __init__(self, shape: tuple[int, int], options: dict[str, Any],
                 tracker: NativeTracker | None = None) -> None:
        self.shape = shape
        if tracker is None:
            config = native.defaults()
            config['stages'] = _EXTRACTS
            set_extraction(config, options)
            try:
                tracker = NativeTracker(config, _any_camera(shape))
            except native.NativeError as error:
                raise ValueError(f'images of {shape[1]} x {shape[0]} px: {error}') from error
        self._tracker = tracker
        self._image, self._extraction = (np.zeros((), kind) for kind in (
            native.IMAGE, native.EXTRACTION))
        self.image_at, self._extraction_at = (
            self._image.ctypes.data, self._extraction.ctypes.data)

    def is_of(self, image: np.ndarray, cell: int = 1) -> bool:
        """Return whether an image is one of the camera, of which each pixel is cell x cell."""
        return (self.shape[0] // cell, self.shape[1] // cell) == image.shape

    def change_options(self, options: dict[str, Any]) -> None:
        """Use options of which only live ones differ; NativeError for others."""
        set_extraction(self._tracker.config, options)
        self._tracker.change_options()

    def reset(self) -> None:
        """Forget the images before."""
        self._tracker.call('st_reset')

    def extract(self, stamp_ns: int, image: np.ndarray, predicted: PredictedCentroids | None,
                lost: bool, cell: int, exposure_s: float) -> Found:
        """Return what st_extract() finds."""
        predictions, count, predicted_ns = None, 0, 0
        if predicted is not None:
            count, predicted_ns = len(predicted.uv), predicted.stamp_ns
            table = np.zeros(count, native.PREDICTION)
            table['u_px'], table['v_px'] = predicted.uv.T
            table['u_rate_px_s'], table['v_rate_px_s'] = predicted.velocity.T
            table['sigma_px'], table['hip'] = predicted.sigma_px, predicted.hip
            predictions = table.ctypes.data
        image = self.given(image, cell, exposure_s)
        self._tracker.call('st_extract', stamp_ns, self.image_at, predictions, count,
                           predicted_ns, lost, self._extraction_at)
        return self.found(self._extraction)

    def search(self, image: np.ndarray, streak: Streak | None, before: np.ndarray | None,
               after: np.ndarray, threshold_factor: float, *how: int) -> tuple[Found, bool]:
        """Return what st_search() finds, and whether it has filled after."""
        options, kept = np.zeros((), native.SEARCH_OPTIONS), ctypes.c_int32()
        options[()] = (threshold_factor, *how, 0)
        motion, image = _motion(streak), self.given(image)
        self._tracker.call(
            'st_search', self.image_at, options.ctypes.data, address_of(motion),
            address_of(before), after.ctypes.data, ctypes.byref(kept), self._extraction_at)
        return self.found(self._extraction), bool(kept.value)

    def search_near(self, image: np.ndarray, uv: np.ndarray, radius_px: np.ndarray,
                    streak: Streak | None, before: np.ndarray, after: np.ndarray) -> Found:
        """Return what st_search_near() finds."""
        uv, radius_px = (np.ascontiguousarray(array, float) for array in (uv, radius_px))
        motion, image = _motion(streak), self.given(image)
        self._tracker.call(
            'st_search_near', self.image_at, uv.ctypes.data, radius_px.ctypes.data, len(uv),
            address_of(motion), before.ctypes.data, after.ctypes.data, self._extraction_at)
        return self.found(self._extraction)

    def find_spots(self, image: np.ndarray, cell_share: float, calm: bool) -> Centroids:
        """Return the spots of st_find_spots()."""
        image = self.given(image)
        self._tracker.call('st_find_spots', self.image_at, cell_share, calm)
        return centroids_of(self._tracker.listed('st_centroids', native.CENTROID))

    def find_highest_peaks(self, image: np.ndarray) -> Centroids:
        """Return the peaks of st_find_highest_peaks()."""
        image = self.given(image)
        self._tracker.call('st_find_highest_peaks', self.image_at)
        return centroids_of(self._tracker.listed('st_centroids', native.CENTROID))

    def measure_widths(self, image: np.ndarray, searched: np.ndarray, most: int) -> np.ndarray:
        """Return place and PSF sigma (K, 3) in px of st_measure_widths()."""
        widths, image = np.empty((most, 3)), self.given(image)
        self._tracker.call(
            'st_measure_widths', self.image_at, searched.ctypes.data, widths.ctypes.data, most,
            ctypes.byref(self._tracker.count))
        return widths[:self._tracker.count.value]

    def full_scale(self, image: np.ndarray, background_dn: float) -> float:
        """Return the DN of st_full_scale()."""
        found, image = ctypes.c_double(), self.given(image)
        self._tracker.call('st_full_scale', self.image_at, background_dn, ctypes.byref(found))
        return found.value

    def searched(self) -> np.ndarray:
        """Return memory for what a searched image leaves."""
        self._tracker.call('st_searched_size', ctypes.byref(self._tracker.count))
        return aligned(self._tracker.count.value)

    def given(self, image: np.ndarray, cell: int = 1, exposure_s: float = 0.0) -> np.ndarray:
        """Set the IMAGE of the next call, at image_at; return its pixels, which have to stay."""
        height, width = image.shape
        down, across = image.strides
        if across != image.itemsize or down < width * across or down % across or (
                not image.flags.aligned):
            image = np.require(image, None, ['C', 'A'])
            down = width * image.itemsize
        self._image[()] = (
            image.ctypes.data, down, width, height, image.itemsize == 2, cell, exposure_s)
        return image

    def found(self, extraction: np.ndarray) -> Found:
        """Return the results of a call that has filled an EXTRACTION."""
        rejected = self._tracker.listed('st_rejections', native.REJECTED)
        centroids = self._tracker.listed('st_centroids', native.CENTROID)
        figures = figures_of(extraction)
        return Found(figures, centroids_of(centroids, figures),
                     np.stack([rejected['u_px'], rejected['v_px']], -1))


def set_extraction(config: np.ndarray, options: dict[str, Any]) -> None:
    """Set options of a CONFIG, with room for any change of them."""
    config['capacities']['predictions'] = config['capacities']['centroids'] = _MOST
    for name, value in options.items():
        config['extraction'][name] = value


def figures_of(extraction: np.ndarray) -> dict[str, Any]:
    """Return an EXTRACTION by its names."""
    return dict(zip(_NAMES, extraction.item()))


def _any_camera(shape: tuple[int, int]) -> np.ndarray:
    """Return a camera with images of this shape (H, W): its lens plays no part here."""
    camera = np.zeros((), native.CAMERA)
    camera['height_px'], camera['width_px'] = shape
    camera['fx_px'] = camera['fy_px'] = 2.0 * max(shape)
    camera['cx_px'], camera['cy_px'] = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    return camera


def _motion(streak: Streak | None) -> np.ndarray | None:
    return None if streak is None else np.array(streak, float)


def centroids_of(table: np.ndarray, figures: Mapping[str, Any] = UNKNOWN) -> Centroids:
    """Return a table (N,) of CENTROID, with the exposure of an EXTRACTION by its names."""
    return Centroids.of(table.view(float).reshape(len(table), table.itemsize // 8),
                        (figures['exposure_least_s'], figures['exposure_most_s']))
