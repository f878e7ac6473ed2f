# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The frames of a night through the star tracker, and each by itself."""

from collections.abc import Iterable, Sequence
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.aberration import (
    apparent_directions, ObserverState, state_near_earth)
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, why_no_date
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.astro.observer_motion import Observer
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions, Searched
from startracker_ros.core.frame_result import Attitude
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import attitude_error, conjugate, rotate
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.photographs.calibrate import MAX_STARS
from startracker_ros.tools.night.earth_motion import EarthMotion, inliers
from startracker_ros.tools.night.patterns import Stars, without_turns
from startracker_ros.tools.night.sources import NightError, TimedImage

_WIDTH_STARS = 60
_WIDTH_SNR = 30.0  # of stars whose PSF sigma is known to some per cent
_GAP_INTERVALS = 2.5  # of the usual one, that the star tracker bridges
_NEAR_PX = 4.0
"""Largest distance of a centroid from its star: of the lens that is not in the camera file."""
_MARGIN_PX = 4.0  # from the edges, where windows are cut
_LENS_PX = 0.05
"""1 sigma added to that of centroids in weights, for errors that they do not contain."""


class Frame(NamedTuple):
    """
    What one image shows: centroids, attitudes, widths.

    onboard are the stars. alone is q_icrf_from_sensor (4,) of this image identified by itself,
    published that of the star tracker, each None without; width_uv (K, 2) px and width_px (K,)
    are PSF sigmas.
    """

    stamp_ns: int
    centroids: Centroids
    onboard: OnboardCatalog
    observer_state: ObserverState
    alone: np.ndarray | None
    published: Attitude | None
    width_uv: np.ndarray
    width_px: np.ndarray


def observe(images: Iterable[TimedImage], camera: Camera, site: Site | None) -> list[Frame]:
    """
    Return what the images of a camera show.

    NightError for images of another size, and unless each is later than the one before. A site
    adds its velocity and its air to the places of stars. The star tracker has its defaults, but
    for the time it bridges where frames are far apart.
    """
    images = iter(images)
    first = [*islice(images, 2)]
    if len(first) < 2:
        raise NightError(f'{len(first)} images are not a night')
    if no_date := why_no_date(first[0].stamp_ns):
        raise NightError(no_date)
    year = epoch_year_from_stamp(first[0].stamp_ns)
    tracker = StarTracker(
        camera, year, **_bridging((first[1].stamp_ns - first[0].stamp_ns) * 1e-9))
    identifier = make_identifier(camera, year)
    onboard = camera_stars(camera, year)
    extractor = CentroidExtractor(ExtractionOptions(max_stars=MAX_STARS))
    frames: list[Frame] = []
    for stamp_ns, image in chain(first, images):
        if frames and stamp_ns <= frames[-1].stamp_ns:
            raise NightError(f'image {len(frames) + 1} is not later than the one before it')
        if image.shape != (camera.height, camera.width):
            raise NightError(f'image {len(frames) + 1} of {image.shape[1]} x {image.shape[0]} px, '
                             f'the camera has {camera.width} x {camera.height}')
        now = epoch_year_from_stamp(stamp_ns)
        if site is not None:
            tracker.add_observer(stamp_ns, site.position_m(now), site.velocity_m_s(now))
        published = tracker.process(stamp_ns, image).attitude
        extraction, searched = extractor.search(image)
        observer_state = _observer_state(now, site)
        found = icrf_identification(
            identifier.identify(extraction.centroids), extraction.centroids, camera,
            ApparentCatalog(onboard, Observer(observer_state, 0.0, 'full')), identifier.options)
        frames.append(Frame(
            stamp_ns, extraction.centroids, onboard, observer_state,
            None if found.attitude is None else found.attitude.quaternion, published,
            *_widths(extractor, image, extraction.centroids, searched)))
    return frames


def _bridging(interval_s: float) -> dict[str, float]:
    """
    Return the options of a star tracker for frames that are far apart, none where its own do.

    The camera moves as steadily as in a second between two frames by default.
    """
    defaults = TrackerOptions()
    gap_s = _GAP_INTERVALS * interval_s
    if gap_s <= defaults.max_gap_s:
        return {}
    steadier = max(1.0, interval_s) ** -2
    return {'max_gap_s': min(gap_s, 600.0),
            'acceleration_deg_s2': max(defaults.acceleration_deg_s2 * steadier, 1e-6),
            'roll_acceleration_deg_s2': max(defaults.roll_acceleration_deg_s2 * steadier, 1e-6)}


def _observer_state(year: float, site: Site | None) -> ObserverState:
    """Return where the observer is; without a site as on an Earth that does not turn."""
    if site is None:
        return state_near_earth(year, np.zeros(3))
    return state_near_earth(year, site.velocity_m_s(year))._replace(air=site.air(year))


def _widths(extractor: CentroidExtractor, image: np.ndarray, centroids: Centroids,
            searched: Searched | None) -> tuple[np.ndarray, np.ndarray]:
    """Return uv (K, 2) and PSF sigma (K,) of bright stars, each fitted by itself."""
    bright = centroids.select(centroids.snr > _WIDTH_SNR)
    if searched is None or not len(bright):
        return np.empty((0, 2)), np.empty(0)
    uv, width = extractor.measure_widths(image, searched, _WIDTH_STARS)
    _, near = nearest(bright.uv, uv, 1.0)
    return uv[near], width[near]


def nearest(points: np.ndarray, uv: np.ndarray, radius_px: float
            ) -> tuple[np.ndarray, np.ndarray]:
    """Return the index (N,) of the nearest of points to uv (N, 2), and whether it is near."""
    if not (len(points) and len(uv)):
        return np.zeros(len(uv), int), np.zeros(len(uv), bool)
    square = ((uv[:, None] - points) ** 2).sum(axis=-1)
    index = square.argmin(axis=1)
    return index, square[np.arange(len(uv)), index] < radius_px ** 2


def star_rows(frames: Sequence[Frame], motion: EarthMotion, camera: Camera) -> Stars:
    """Return the catalogue stars in the frames that have an attitude of their own."""
    fitted = motion.icrf(np.array([frame.stamp_ns for frame in frames]))
    parts = [_stars_of(number, frame, frame.alone, q, camera)
             for number, (frame, q) in enumerate(zip(frames, fitted)) if frame.alone is not None]
    rows = Stars(*map(np.concatenate, zip(*parts)))
    # A star that is another one, or none, is off by more than the stars of its frame.
    ok = np.flatnonzero(rows.seen)
    seen = rows.select(rows.seen)
    wrong = ok[~inliers(without_turns(seen, seen.residual[..., None])[..., 0])]
    rows.seen[wrong] = False
    return rows


def _stars_of(number: int, frame: Frame, q_alone: np.ndarray, q_fitted: np.ndarray,
              camera: Camera) -> Stars:
    onboard = frame.onboard
    near = onboard.within(rotate(q_alone, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    near = near[~onboard.blended[near]]
    direction = apparent_directions(onboard.direction[near], frame.observer_state)
    expected = camera.project(rotate(conjugate(q_alone), direction))
    inside = camera.contains(expected, _MARGIN_PX)
    near, direction, expected = near[inside], direction[inside], expected[inside]
    without_air = apparent_directions(
        onboard.direction[near], frame.observer_state._replace(air=None))
    index, seen = nearest(frame.centroids.uv, expected, _NEAR_PX)
    measured = np.where(seen[:, None], _of(frame.centroids.uv, index), np.nan)
    sensor = rotate(conjugate(q_fitted), direction)
    fitted, unlifted = (camera.project(each) for each in (
        sensor, rotate(conjugate(q_fitted), without_air)))
    return Stars(
        np.full(len(near), number), near, onboard.magnitude[near], expected, seen,
        measured - fitted,
        np.hypot(np.where(seen, _of(frame.centroids.sigma_px, index), np.nan), _LENS_PX),
        image_jacobian(camera, sensor), fitted - unlifted)


def _of(column: np.ndarray, index: np.ndarray) -> np.ndarray:
    return column[index] if len(column) else np.full((len(index), *column.shape[1:]), np.nan)


def published_errors(frames: Sequence[Frame], motion: EarthMotion
                     ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps (P,), errors (P, 3) rad about the motion and covariances of published ones."""
    chosen = [(frame.stamp_ns, frame.published) for frame in frames
              if frame.published is not None]
    stamps = np.array([stamp for stamp, _ in chosen], np.int64)
    if not chosen:
        return stamps, np.empty((0, 3)), np.empty((0, 3, 3))
    error = attitude_error(np.array([each.quaternion for _, each in chosen]), motion.icrf(stamps))
    return stamps, error, np.array([each.covariance_sensor for _, each in chosen])
