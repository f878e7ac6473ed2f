# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A tracker of the native library that identifies stars, and its results in Python."""

import ctypes
from dataclasses import replace
import math
from threading import Lock
import time
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.native import NativeTracker
from startracker_ros.core.native_tracker import attitude_of, IDENTIFIES, MOST_CENTROIDS

STATUSES = ('not_due', 'identified', 'too_few_stars', 'no_candidate', 'ambiguous', 'time_limit',
            'searching')
"""Names of st_identification_status, in their order."""

_SEARCHING = STATUSES.index('searching')
_IDENTIFICATION = [name for name in native.IDENTIFICATION.names or () if name != 'attitude']

# Of a search, until the clock is read.
_SLICE_S = 2e-3


class BrightLevel(NamedTuple):
    """How many catalogue stars, image stars and triangles the first, brighter level has."""

    stars_per_field: float
    image_stars: int
    triangles: int


class Rules(NamedTuple):
    """
    What accepts a candidate, in addition to the options of an identification.

    scale_error is that of the focal length, a share. Where bases_by_brightness, the stars of a
    candidate were chosen by their brightness, which is then no evidence for them. lens_known is
    False for a lens that is fitted after the identification: its near misses are then expected.
    """

    scale_error: float
    bases_by_brightness: bool = False
    lens_known: bool = True


class Found(NamedTuple):
    """
    What a search found: status is one of STATUSES, reason the figures of its st_reason.

    hip, magnitude, residual_px (N,) are of each centroid, empty without an attitude.
    """

    status: str
    figures: tuple[float, ...]
    false_alarm: float
    focal_ratio: float
    work_s: float
    stars: int
    tested: int
    hip: np.ndarray = np.empty(0, np.int32)
    magnitude: np.ndarray = np.empty(0)
    residual_px: np.ndarray = np.empty(0)
    attitude: AttitudeEstimate | None = None


Verified = tuple[float, float, np.ndarray, np.ndarray, AttitudeEstimate | None]
"""False alarm, focal ratio, stars (N,), residuals (N,) px and attitude of an st_verification."""


class StarMatcher:
    """
    A tracker for lists of centroids of a camera, in memory of its own.

    options are the fields of st_identification_options. Without pairs it verifies candidates that
    were found elsewhere. CameraError is of the camera; ValueError for an option out of range.
    """

    def __init__(self, camera: Camera, onboard: OnboardCatalog, options: dict[str, Any],
                 rules: Rules, pairs: PairDatabase | None = None,
                 bright_pairs: PairDatabase | None = None,
                 bright: BrightLevel = BrightLevel(0.0, 0, 0)) -> None:
        self._uses = Lock()
        config = native.defaults()
        config['stages'] = IDENTIFIES
        for name, value in options.items():
            config['identification'][name] = value
        self._tracker = NativeTracker(config, camera.native, None, native_patterns(
            onboard, rules, pairs, bright_pairs, bright))
        self._table = np.zeros((MOST_CENTROIDS, native.CENTROID.itemsize // 8))
        self._result = np.zeros((), native.IDENTIFICATION)
        self._result_at, self._table_at = self._result.ctypes.data, self._table.ctypes.data
        self._stars = np.zeros((), native.IMAGE_STARS)
        self._verification = np.zeros((), native.VERIFICATION)

    def identify(self, centroids: Centroids, until_s: np.ndarray | None = None,
                 work_s: float = math.inf) -> Found:
        """
        Return what a search finds by so much work.

        Another thread may end it: until_s (1,) is the time.monotonic() at which it ends.
        """
        count, rows = len(centroids), None
        if count > MOST_CENTROIDS:
            rows = np.argsort(-centroids.flux, kind='stable')[:MOST_CENTROIDS]
        with self._uses:
            used = self._set(centroids, rows)
            slice_s = min(work_s, _SLICE_S) if until_s is not None else work_s
            self._tracker.call(
                'st_identify', 0, self._table_at, used, slice_s, None, self._result_at)
            while until_s is not None and self._result['status'] == _SEARCHING and (
                    time.monotonic() < until_s[0]):
                self._tracker.call('st_identify_on', slice_s, None, self._result_at)
            return found_of(self._result.copy(), self._tracker, count, rows)

    def _set(self, centroids: Centroids, rows: np.ndarray | None) -> int:
        """Fill in the table of the next call; return its length."""
        if rows is not None:
            centroids = centroids.select(rows)
        used = len(centroids)
        table = self._table[:used]
        table[:, :2], table[:, 2], table[:, 4] = centroids.uv, centroids.flux, centroids.sigma_px
        return used

    def support(self, direction: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                candidates: np.ndarray) -> np.ndarray:
        """Return the support (M,) of candidates (M, 3) of st_support()."""
        three, stars = (np.ascontiguousarray(array, np.int32) for array in (base, candidates))
        found = np.empty(len(stars))
        with self._uses:
            kept = self._set_stars(direction, sigma_rad)
            self._tracker.call(
                'st_support', self._stars.ctypes.data, three.ctypes.data, stars.ctypes.data,
                len(stars), found.ctypes.data)
            del kept
        return found

    def verify(self, direction: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
               star: np.ndarray, tested: float) -> Verified:
        """Return the result of st_verify()."""
        given, chosen = (np.ascontiguousarray(array, np.int32) for array in (base, star))
        return self._verified('st_verify', direction, sigma_rad,
                              (given, chosen, len(given), float(tested)))

    def few_stars(self, direction: np.ndarray, sigma_rad: np.ndarray, table: np.ndarray,
                  false_alarm_max: float, work_s: float) -> tuple[Verified, float]:
        """Return the result of st_few_stars(), and its work in s."""
        spent_s = np.empty(1)
        return self._verified('st_few_stars', direction, sigma_rad,
                              (table, false_alarm_max, work_s), (spent_s,)), float(spent_s[0])

    def _verified(self, name: str, direction: np.ndarray, sigma_rad: np.ndarray,
                  before: tuple[Any, ...], after: tuple[np.ndarray, ...] = ()) -> Verified:
        """Return the verification of a function, with its arguments before and after that."""
        count = len(sigma_rad)
        star, residual_px, residual_rad = (
            np.empty(count, np.int32), np.empty(count), np.empty(count))
        with self._uses:
            kept = self._set_stars(direction, sigma_rad)
            native.call(name, self._tracker.handle, self._stars, *before, self._verification, star,
                        residual_px, residual_rad, *after)
            del kept
            found = self._verification.copy()
        angles_rad = residual_rad[residual_rad >= 0]
        attitude = (replace(attitude_of(found['attitude']), stars=len(angles_rad),
                            residual_rad=angles_rad) if found['attitude']['valid'] else None)
        return (float(found['false_alarm_probability']), float(found['focal_ratio']),
                star.astype(int), residual_px, attitude)

    def best_of_quads(self, direction: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                      star: np.ndarray, least_support: float, tested: float
                      ) -> tuple[int, float]:
        """Return the best candidate, -1 for none, and its false alarm of st_verify_quads()."""
        given, chosen = (np.ascontiguousarray(array, np.int32) for array in (base, star))
        best, false_alarm = ctypes.c_int32(), ctypes.c_double()
        with self._uses:
            kept = self._set_stars(direction, sigma_rad)
            self._tracker.call(
                'st_verify_quads', self._stars.ctypes.data, given.ctypes.data, chosen.ctypes.data,
                len(given), least_support, tested, ctypes.byref(best),
                ctypes.byref(false_alarm))
            del kept
        return best.value, false_alarm.value

    def _set_stars(self, direction: np.ndarray, sigma_rad: np.ndarray) -> tuple[np.ndarray, ...]:
        """Set the st_image_stars of the next call; return the arrays, which have to stay."""
        kept = tuple(np.ascontiguousarray(array, float) for array in (direction, sigma_rad))
        self._stars[()] = (*(array.ctypes.data for array in kept), len(sigma_rad), 0)
        return kept


def usable_stars(camera: Camera, centroids: Centroids, max_stars: int, sigma_floor_px: float
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the brightest usable centroids, each star once.

    Their rows (N,), directions (N, 3) and errors (N,) in rad.
    """
    order = np.argsort(-centroids.flux, kind='stable').astype(np.int32)
    table = np.zeros((len(order), native.CENTROID.itemsize // 8))
    table[:, :2], table[:, 4] = centroids.uv, centroids.sigma_px
    index, direction, sigma_rad = (
        np.empty(max_stars, np.int32), np.empty((max_stars, 3)), np.empty(max_stars))
    count = ctypes.c_size_t(max_stars)
    native.check(native.library().st_usable_stars(
        camera.native.ctypes.data, table.ctypes.data, order.ctypes.data, len(order),
        sigma_floor_px, index.ctypes.data, direction.ctypes.data, sigma_rad.ctypes.data,
        ctypes.byref(count)))
    chosen = slice(count.value)
    return index[chosen].astype(int), direction[chosen], sigma_rad[chosen]


def native_patterns(onboard: OnboardCatalog, rules: Rules, pairs: PairDatabase | None = None,
                    bright_pairs: PairDatabase | None = None,
                    bright: BrightLevel = BrightLevel(0.0, 0, 0)
                    ) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return PATTERNS of a catalogue and its pairs, and the arrays that they are of."""
    patterns, grid = np.zeros((), native.PATTERNS), onboard.grid
    kept: list[np.ndarray] = []

    def address(array: np.ndarray, kind: type) -> int:
        kept.append(np.ascontiguousarray(array, kind))
        return int(kept[-1].ctypes.data)

    for name, array, kind in (
            ('hip', onboard.hip, np.int32), ('direction', grid.direction, float),
            ('magnitude', onboard.magnitude, float), ('blended', onboard.blended, bool),
            ('start', grid.start, np.int32), ('member', grid.member, np.int32)):
        patterns[name] = address(array, kind)
    for name, table in (('pairs', pairs), ('bright', bright_pairs)):
        if table is not None:
            patterns[name] = (
                *(address(array, kind) for array, kind in (
                    (table.star, np.int32), (table.direction, float), (table.separation, float),
                    (table.below, np.int32), (table.member, np.int32),
                    (table.previous, np.int32))),
                len(table.star), len(table.separation))
    patterns['scale_error'] = rules.scale_error
    patterns['stars'], patterns['cells'] = len(onboard.hip), grid.cells
    patterns['in_cells'] = len(grid.member)
    patterns['bright_image_stars'] = bright.image_stars
    patterns['bright_triangles'] = bright.triangles
    patterns['most_centroids'] = MOST_CENTROIDS
    patterns['bases_by_brightness'] = rules.bases_by_brightness
    patterns['lens_unknown'] = not rules.lens_known
    return patterns, kept


def found_of(result: np.ndarray, tracker: NativeTracker, count: int,
             rows: np.ndarray | None = None) -> Found:
    """
    Return the IDENTIFICATION of a search of a tracker, of which it keeps views.

    count is the number of centroids, rows those that were searched, None for all of them.
    """
    ratio, false_alarm, work_s, status, stars, _, tested, reason = (
        result[name].item() for name in _IDENTIFICATION)
    name, figures = STATUSES[status], tuple(reason[2])
    if name != 'identified':
        return Found(name, figures, false_alarm, ratio, work_s, stars, tested)
    known = tracker.listed('st_identified_stars', native.IDENTIFIED)
    hip, magnitude, residual_px = (known[column].copy() for column in (
        'hip', 'magnitude', 'residual_px'))
    if rows is not None:
        hip, magnitude, residual_px = (
            _spread(column, count, rows, empty) for column, empty in (
                (hip, 0), (magnitude, np.nan), (residual_px, np.nan)))
    angles_rad = known['residual_rad']
    return Found(name, (), false_alarm, ratio, work_s, stars, tested, hip, magnitude, residual_px,
                 replace(attitude_of(result['attitude']), stars=stars,
                         residual_rad=angles_rad[angles_rad >= 0]))


def _spread(column: np.ndarray, count: int, rows: np.ndarray, empty: float) -> np.ndarray:
    """Return a column of some rows as one of all centroids."""
    full = np.full(count, empty, column.dtype)
    full[rows] = column
    return full
