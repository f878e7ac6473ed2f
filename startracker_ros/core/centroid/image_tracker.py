# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A tracker of the native library that extracts stars, and its results in Python."""

import ctypes
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.centroid.streak import Streak

THRESHOLDS = ('sigma', 'fixed', 'iterative')
WEIGHTS = ('binary', 'grey', 'squared', 'thresholded')
METHODS = ('gaussian', *WEIGHTS)
KINDS = ('edge', 'saturated', 'hot_pixel', 'cosmic_ray', 'elongated', 'too_wide', 'not_fitted',
         'faint', 'not_streaked', 'disc', 'line')
"""Names of st_threshold, st_centroid_method and st_rejection, in their order."""

_ALIGNMENT = 64
_EXTRACTS = 1  # ST_EXTRACTS
_MOST = 5000  # the largest capacity of predictions and centroids
_COVARIANCE, _COMMON = (5, 6, 6, 7), (8, 9, 9, 10)  # columns of an st_centroid
_NAMES = native.EXTRACTION.names or ()


class Found(NamedTuple):
    """
    What was found in an image: an st_extraction by its names, and its lists.

    reason is the code and the figures of its st_reason, rejected_uv (R, 2) px.
    """

    figures: dict[str, Any]
    reason: tuple[int, tuple[float, ...]]
    centroids: Centroids
    rejected_uv: np.ndarray

    @property
    def rejected(self) -> dict[str, int]:
        """Return how many spots are left out for each of the KINDS that there are."""
        return {kind: int(count) for kind, count in zip(KINDS, self.figures['rejected_by_kind'])
                if count}

    @property
    def streak(self) -> Streak | None:
        """Return the motion fitted with, None for points."""
        found = Streak(*(self.figures[f'streak_{name}'] for name in (
            'u_px', 'v_px', 'roll_rad', 'at_u_px', 'at_v_px')))
        return None if np.isnan(found.u_px) else found


class ImageTracker:
    """
    A tracker for images of a camera, (H, W), in memory of its own; one thread uses it at a time.

    options are the fields of st_extraction_options. ValueError for a camera that is too large.
    """

    def __init__(self, shape: tuple[int, int], options: dict[str, Any]) -> None:
        self.shape = shape
        self._library = native.library()
        config, camera, fault = _config(options), _any_camera(shape), np.zeros((), native.FAULT)
        size, self._handle = ctypes.c_size_t(), ctypes.c_void_p()
        given = config.ctypes.data, camera.ctypes.data, None
        try:
            native.check(self._library.st_size(*given, ctypes.byref(size)))
            self._memory = aligned(size.value)
            native.check(self._library.st_create(
                self._memory.ctypes.data, size.value, *given, ctypes.byref(self._handle),
                fault.ctypes.data), fault)
        except native.NativeError as error:
            raise ValueError(f'images of {shape[1]} x {shape[0]} px: {error}') from error
        self._image, self._extraction = (np.zeros((), kind) for kind in (
            native.IMAGE, native.EXTRACTION))
        self._image_at, self._extraction_at = (
            self._image.ctypes.data, self._extraction.ctypes.data)
        self._count = ctypes.c_size_t()

    def is_of(self, image: np.ndarray, cell: int = 1) -> bool:
        """Return whether an image is one of the camera, of which each pixel is cell x cell."""
        return (self.shape[0] // cell, self.shape[1] // cell) == image.shape

    def change_options(self, options: dict[str, Any]) -> None:
        """Use options of which only live ones differ; NativeError for others."""
        config, fault = _config(options), np.zeros((), native.FAULT)
        native.check(self._library.st_change_options(
            self._handle, config.ctypes.data, fault.ctypes.data), fault)

    def reset(self) -> None:
        """Forget the images before."""
        native.check(self._library.st_reset(self._handle))

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
        image = self._set(image, cell, exposure_s)
        native.check(self._library.st_extract(
            self._handle, stamp_ns, self._image_at, predictions, count, predicted_ns, lost,
            self._extraction_at))
        return self._found()

    def search(self, image: np.ndarray, streak: Streak | None, before: np.ndarray | None,
               after: np.ndarray, threshold_factor: float, *how: int) -> tuple[Found, bool]:
        """Return what st_search() finds, and whether it has filled after."""
        options, kept = np.zeros((), native.SEARCH_OPTIONS), ctypes.c_int32()
        options[()] = (threshold_factor, *how, 0)
        motion, image = _motion(streak), self._set(image)
        native.check(self._library.st_search(
            self._handle, self._image_at, options.ctypes.data, _address(motion),
            _address(before), after.ctypes.data, ctypes.byref(kept), self._extraction_at))
        return self._found(), bool(kept.value)

    def search_near(self, image: np.ndarray, uv: np.ndarray, radius_px: np.ndarray,
                    streak: Streak | None, before: np.ndarray, after: np.ndarray) -> Found:
        """Return what st_search_near() finds."""
        uv, radius_px = (np.ascontiguousarray(array, float) for array in (uv, radius_px))
        motion, image = _motion(streak), self._set(image)
        native.check(self._library.st_search_near(
            self._handle, self._image_at, uv.ctypes.data, radius_px.ctypes.data, len(uv),
            _address(motion), before.ctypes.data, after.ctypes.data, self._extraction_at))
        return self._found()

    def find_spots(self, image: np.ndarray, cell_share: float, calm: bool) -> Centroids:
        """Return the spots of st_find_spots()."""
        image = self._set(image)
        native.check(self._library.st_find_spots(self._handle, self._image_at, cell_share, calm))
        return _centroids(self._list('st_centroids', native.CENTROID))

    def measure_widths(self, image: np.ndarray, searched: np.ndarray, most: int) -> np.ndarray:
        """Return place and PSF sigma (K, 3) in px of st_measure_widths()."""
        widths, image = np.empty((most, 3)), self._set(image)
        native.check(self._library.st_measure_widths(
            self._handle, self._image_at, searched.ctypes.data, widths.ctypes.data, most,
            ctypes.byref(self._count)))
        return widths[:self._count.value]

    def full_scale(self, image: np.ndarray, background_dn: float) -> float:
        """Return the DN of st_full_scale()."""
        found, image = ctypes.c_double(), self._set(image)
        native.check(self._library.st_full_scale(
            self._handle, self._image_at, background_dn, ctypes.byref(found)))
        return found.value

    def searched(self) -> np.ndarray:
        """Return memory for what a searched image leaves."""
        native.check(self._library.st_searched_size(self._handle, ctypes.byref(self._count)))
        return aligned(self._count.value)

    def _set(self, image: np.ndarray, cell: int = 1, exposure_s: float = 0.0) -> np.ndarray:
        """Set the st_image of the next call; return the pixels, which have to stay."""
        height, width = image.shape
        down, across = image.strides
        if across != image.itemsize or down < width * across or down % across or (
                not image.flags.aligned):
            image = np.require(image, None, ['C', 'A'])
            down = width * image.itemsize
        self._image[()] = (
            image.ctypes.data, down, width, height, image.itemsize == 2, cell, exposure_s)
        return image

    def _list(self, name: str, kind: np.dtype) -> np.ndarray:
        """Return a copy of a list of the last call."""
        first = getattr(self._library, name)(self._handle, ctypes.byref(self._count))
        size = self._count.value * kind.itemsize
        return np.frombuffer(ctypes.string_at(first, size) if size else b'', kind).copy()

    def _found(self) -> Found:
        """Return the results of a call that has filled the st_extraction."""
        figures = dict(zip(_NAMES, self._extraction.item()))
        code, _, numbers = figures['reason']
        rejected = self._list('st_rejections', native.REJECTED)
        return Found(
            figures, (code, tuple(numbers)),
            _centroids(self._list('st_centroids', native.CENTROID),
                       (figures['exposure_least_s'], figures['exposure_most_s'])),
            np.stack([rejected['u_px'], rejected['v_px']], -1))


def aligned(size: int) -> np.ndarray:
    """Return memory (size,) uint8 as the library needs it."""
    block = np.empty(size + _ALIGNMENT, np.uint8)
    first = -block.ctypes.data % _ALIGNMENT
    return block[first:first + size]


def _config(options: dict[str, Any]) -> np.ndarray:
    """Return the st_config of a tracker that extracts, with room for any change of options."""
    config = native.defaults()
    config['stages'] = _EXTRACTS
    config['capacities']['predictions'] = config['capacities']['centroids'] = _MOST
    for name, value in options.items():
        config['extraction'][name] = value
    return config


def _any_camera(shape: tuple[int, int]) -> np.ndarray:
    """Return a camera with images of this shape (H, W): its lens plays no part here."""
    camera = np.zeros((), native.CAMERA)
    camera['height_px'], camera['width_px'] = shape
    camera['fx_px'] = camera['fy_px'] = 2.0 * max(shape)
    camera['cx_px'], camera['cy_px'] = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    return camera


def _motion(streak: Streak | None) -> np.ndarray | None:
    return None if streak is None else np.array(streak, float)


def _address(array: np.ndarray | None) -> int | None:
    return None if array is None else array.ctypes.data


def _centroids(table: np.ndarray, exposure_s: tuple[float, float] = (0.0, np.inf)) -> Centroids:
    """Return a list of st_centroid."""
    count = len(table)
    columns = table.view(float).reshape(count, table.itemsize // 8)
    return Centroids(
        columns[:, :2], columns[:, 2], columns[:, 3], columns[:, 4],
        columns[:, _COVARIANCE].reshape(count, 2, 2), columns[:, 11].copy(),
        columns[:, _COMMON].reshape(count, 2, 2), exposure_s)
