# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Centroids that the catalogue does not explain: moving objects and hot pixels of a segment."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.astro.state import State
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.maths.rotation import (
    ARCSEC, east_and_north, matrix_from_quaternion, unit_from_radec)
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.target import MOST_SPOTS, unexplained
from startracker_ros.core.track.tracklets import Detections, link_tracklets

TRACKLET_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), ('tracklet', 'i8'), ('ra_deg', 'f8'), ('dec_deg', 'f8'),
    ('cov_ee_arcsec2', 'f4'), ('cov_en_arcsec2', 'f4'), ('cov_nn_arcsec2', 'f4'),
    ('magnitude', 'f4'), ('u', 'f4'), ('v', 'f4'), ('sigma_px', 'f4'),
    *((f'position_{axis}_m', 'f8') for axis in 'xyz'),
    *((f'velocity_{axis}_m_s', 'f8') for axis in 'xyz')])
"""
One row for each detection of a moving object. A segment has the detections in its overlap as well:
those of an object that crosses its border stand in both segments, at equal stamps and pixels. The
direction is the apparent one on ICRF axes: neither aberration nor light time is removed; its
covariance is on axes to the east and north. Position and velocity are those of the observer,
geocentric, NaN without odometry.
"""

PIXEL_DTYPE = np.dtype([('stamp_ns', 'i8'), ('u', 'i4'), ('v', 'i4'), ('count', 'i4')])
"""Hot pixels: pixels with the centre of a spot that is not a star, and the frames that have it."""

_HOT_SPAN_S = 60.0
_LEAST_HOT = 10
_TRACKLETS = 1000
_UNKNOWN = State(np.full(3, np.nan), np.full(3, np.nan), np.full((3, 3), np.nan))


class _Spots(NamedTuple):
    """
    The spots (M,) of a frame that are not stars, and what turns them into directions.

    held is whether the frame is one of the segment, and not of its overlap.
    """

    frame: int
    held: bool
    stamp_ns: int
    uv: np.ndarray
    sigma_px: np.ndarray
    flux: np.ndarray
    quaternion: np.ndarray
    covariance: np.ndarray
    zero_point_mag: float
    state: State
    camera: Camera


class Leftovers:
    """Collects the leftovers of the frames of a segment."""

    def __init__(self) -> None:
        self._frames = 0
        self._spots: list[_Spots] = []
        self._stars: tuple[StarTracker, StarsInView] | None = None

    def add(self, stamp_ns: int, camera: Camera, centroids: Centroids, frame: FrameResult,
            pipeline: StarTracker, zero_point_mag: float, held: bool) -> None:
        """Add a frame, held by the segment or of its overlap; without an attitude it counts."""
        self._frames += 1
        attitude = frame.attitude
        if attitude is None:
            return
        if self._stars is None or self._stars[0] is not pipeline:
            self._stars = pipeline, StarsInView(camera, pipeline.attitude.sky.onboard)
        left = unexplained(
            self._stars[1], pipeline.attitude.sky.at(stamp_ns), attitude, centroids)
        if not len(left):
            return
        left = left[:MOST_SPOTS]
        self._spots.append(_Spots(
            self._frames, held, stamp_ns, centroids.uv[left], centroids.sigma_px[left],
            centroids.flux[left], attitude.quaternion, attitude.covariance_sensor, zero_point_mag,
            pipeline.motion.geocentric(stamp_ns) or _UNKNOWN, camera))

    def tables(self, begin_ns: int) -> dict[str, np.ndarray]:
        """Return the tables tracklets and hot_pixels of a segment."""
        held = [spots for spots in self._spots if spots.held]
        if not held:
            return {'tracklets': np.empty(0, TRACKLET_DTYPE),
                    'hot_pixels': np.empty(0, PIXEL_DTYPE)}
        return {'tracklets': self._tracklets(begin_ns), 'hot_pixels': _hot_pixels(held, begin_ns)}

    def _tracklets(self, begin_ns: int) -> np.ndarray:
        count = [len(spots.uv) for spots in self._spots]
        rows = _rows(self._spots, count)
        frame = np.repeat([spots.frame for spots in self._spots], count)
        held = np.repeat([spots.held for spots in self._spots], count)
        found = link_tracklets(Detections(
            frame, (rows['stamp_ns'] - rows['stamp_ns'][0]) * 1e-9,
            unit_from_radec(np.radians(rows['ra_deg']), np.radians(rows['dec_deg'])),
            (rows['cov_ee_arcsec2'] + rows['cov_nn_arcsec2']).astype(float) / 2 * ARCSEC ** 2,
            np.stack([rows['u'], rows['v']], -1).astype(float), rows['sigma_px'].astype(float)))
        # An object of the overlap alone is one of the segment before.
        found = [member for member in found if held[member].any()]
        for number, member in enumerate(found):
            rows['tracklet'][member] = begin_ns // 1_000_000_000 * _TRACKLETS + number
        return rows[np.sort(np.concatenate(found))] if found else rows[:0]


def _hot_pixels(found: Sequence[_Spots], begin_ns: int) -> np.ndarray:
    """Return the pixels that have a spot again and again; a star or an object passes."""
    uv = np.concatenate([spots.uv for spots in found])
    stamps = np.repeat([spots.stamp_ns for spots in found], [len(spots.uv) for spots in found])
    width = found[0].camera.width
    u, v = np.rint(uv).astype(int).T
    pixel, which, seen = np.unique(v * width + u, return_inverse=True, return_counts=True)
    first, last = np.full(len(pixel), 2 ** 62), np.zeros(len(pixel), np.int64)
    np.minimum.at(first, which, stamps)
    np.maximum.at(last, which, stamps)
    hot = (seen >= _LEAST_HOT) & (last - first >= _HOT_SPAN_S * 1e9)
    rows = np.zeros(np.count_nonzero(hot), PIXEL_DTYPE)
    rows['stamp_ns'], rows['count'] = begin_ns, seen[hot]
    rows['v'], rows['u'] = np.divmod(pixel[hot], width)
    return rows


def _rows(found: Sequence[_Spots], count: Sequence[int]) -> np.ndarray:
    """
    Return the rows (M,) of the spots of all frames, count (N,) of each.

    A turn e about sensor axes moves a direction by n.e to the east and by -e.east to the north,
    with its axes east and n (north) in the sensor frame.
    """
    def of_frames(values: Any) -> np.ndarray:
        return np.repeat(np.array(values), count, axis=0)
    uv, sigma_px, flux = (np.concatenate(column) for column in zip(*(
        (spots.uv, spots.sigma_px, spots.flux) for spots in found)))
    rows = np.zeros(len(uv), TRACKLET_DTYPE)
    matrix = of_frames(matrix_from_quaternion(np.array([spots.quaternion for spots in found])))
    C = of_frames([spots.covariance for spots in found])
    seen = np.concatenate([camera.unproject(np.concatenate([spots.uv for spots in same]))
                           for camera, same in groupby(found, lambda spots: spots.camera)])
    d = np.einsum('mij,mj->mi', matrix, seen)
    e, n = np.einsum('mji,mkj->kmi', matrix, east_and_north(d))
    variance = (sigma_px * of_frames([spots.camera.pixel_rad for spots in found])) ** 2
    rows['stamp_ns'] = of_frames([spots.stamp_ns for spots in found])
    rows['ra_deg'] = np.degrees(np.arctan2(d[:, 1], d[:, 0])) % 360
    rows['dec_deg'] = np.degrees(np.arcsin(np.clip(d[:, 2], -1, 1)))
    for name, own, a, b in (('ee', variance, n, n), ('nn', variance, e, e), ('en', 0.0, -n, e)):
        rows[f'cov_{name}_arcsec2'] = (own + np.einsum('mi,mij,mj->m', a, C, b)) / ARCSEC ** 2
    with np.errstate(invalid='ignore', divide='ignore'):
        rows['magnitude'] = of_frames([spots.zero_point_mag for spots in found]
                                      ) - 2.5 * np.log10(flux)
    rows['u'], rows['v'] = uv.T
    rows['sigma_px'] = sigma_px
    position_m, velocity_m_s = (of_frames(vectors).T for vectors in zip(*(
        (spots.state.position_m, spots.state.velocity_m_s) for spots in found)))
    for column, axis in enumerate('xyz'):
        rows[f'position_{axis}_m'] = position_m[column]
        rows[f'velocity_{axis}_m_s'] = velocity_m_s[column]
    return rows
