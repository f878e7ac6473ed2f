# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The star tracker as one object: images or centroids of a frame in, trusted attitude out.

The policy stands here once: the tracker processes every frame, its attitude goes out if its tracks
fit it, and a frame is identified unless the tracker follows the stars and no check is due. The
nodes run the same stages side by side, so theirs may use an identification some frames later.
"""

from datetime import datetime
from typing import Any, Self

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.astro.epoch import (
    CatalogueEpoch, checked_stamp, julian_year, NOT_STAMPED, RESTART_NS)
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.astro.state import State
from startracker_ros.core.attitude.gyro import checked_rate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.centroids import Centroids, MADE_BY
from startracker_ros.core.centroid.extraction import check_image
from startracker_ros.core.centroid.image_tracker import (
    centroids_of, figures_of, ImageTracker, set_extraction)
from startracker_ros.core.centroid.reasons import status_and_reason
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.star_matcher import found_of, STATUSES
from startracker_ros.core.integrity.reasons import reason_text
from startracker_ros.core.native_tracker import (
    EXTRACTS, IDENTIFIES, native_centroids, SkyTracker, TRACKS, TRUSTS)
from startracker_ros.core.stages.attitude import AttitudeStage, set_trust
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.parameters import options_of_keywords, StarTrackerOptions
from startracker_ros.core.track.track_filter import set_tracking, TrackFilter
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.core.values import of_type, vector_of

_WITHOUT_RESULT = [STATUSES.index(name) for name in ('not_due', 'searching')]


class StarTracker:
    """
    Images or centroids of one camera in, attitude out: the stages of the nodes in one process.

    Frames come in the order of their stamps, UNIX time in ns of the middle of the exposure. A
    frame that is not newer than the one before is not used, and its result has the reason; one
    that is older by more than a second resets the tracker, as reset() does.

    Stars are identified by their directions without aberration; every attitude that goes out is
    fitted to the apparent directions of its stamp and is that of the sensor in ICRF.
    """

    def __init__(self, camera: Camera, epoch_year: float | datetime | str, **options: Any
                 ) -> None:
        """
        Take the camera, the epoch of the catalogue, and node parameters by name.

        The epoch is a Julian year, or a time as 2026-07-02, UTC where it names no zone.

        A name that several nodes have is set in all of them, unless it is another thing in each:
        star_identifier={'method': 'quad'} is that of one node. ValueError names what is wrong,
        and which names there are.
        """
        self._build(of_type('camera', camera, Camera, 'Camera.from_fov() or load_camera()'),
                    CatalogueEpoch(julian_year(epoch_year, 'epoch_year')),
                    options_of_keywords(options))

    @classmethod
    def with_options(cls, camera: Camera, epoch: float | CatalogueEpoch,
                     options: StarTrackerOptions) -> Self:
        """Return the star tracker with the options of its stages."""
        made = cls.__new__(cls)
        made._build(camera, epoch if isinstance(epoch, CatalogueEpoch) else CatalogueEpoch(epoch),
                    options)
        return made

    def _build(self, camera: Camera, epoch: CatalogueEpoch, options: StarTrackerOptions) -> None:
        self._camera, self._epoch_year = camera, epoch.year
        self.extraction = ExtractionStage(options.extraction, options.search)
        self.identification = IdentificationStage(
            camera, epoch.year, options.identification, options.check, gyro=options.gyro,
            band=options.band)
        self.motion = ObserverMotion(options.aberration, epoch)
        onboard = camera_stars(camera, epoch.year, options.tracker.magnitude_limit, options.band)
        identifier = self.identification.identifier
        config, patterns = native.defaults(), None
        config['stages'] = EXTRACTS | TRACKS | TRUSTS
        # Other methods identify in Python.
        if type(identifier) is PyramidIdentifier:
            config['stages'] |= IDENTIFIES
            patterns = identifier.native_patterns()
            for name, value in identifier.native_options.items():
                config['identification'][name] = value
        config['identification']['check_period_s'] = options.check.check_period_s
        set_extraction(config, self.extraction.options)
        set_tracking(config, options.tracker, options.gyro)
        set_trust(config, options.validation, options.protection)
        # All stages have one copy of tracks and attitude.
        self._native = SkyTracker(config, camera, onboard, self.motion, patterns)
        self._identifies = patterns is not None
        self._result = np.zeros((), native.RESULT)
        self._result_at = self._result.ctypes.data
        self._images = self.extraction.images = ImageTracker(
            (camera.height, camera.width), self.extraction.options, self._native)
        self.tracker = TrackFilter(camera, onboard, options.tracker, options.gyro, self.motion,
                                   self._native, self._result['tracking'])
        self.attitude = AttitudeStage(
            camera, epoch.year, options.validation, self.motion,
            self.tracker.sky if _tracks_all_stars(camera, options) else None,
            options.protection, self._native)
        self._newest_ns: int | None = None

    def reset(self) -> None:
        """Forget all frames and rates: LOST, as after the start."""
        self.extraction.windowed = False
        self.identification.reset()
        self.tracker.reset()
        self._newest_ns = None

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """
        Use the rate (3,) in rad/s of a gyro about sensor axes, measured up to a time.

        Before the frame that follows it. ValueError for another shape, and for what no gyro
        measures, as deg/s or deg/h in place of rad/s.
        """
        stamp_ns, rate_rad_s = checked_stamp(stamp_ns), checked_rate(rate_rad_s)
        self.tracker.add_rate(stamp_ns, rate_rad_s)
        self.identification.add_rate(stamp_ns, rate_rad_s)

    def add_observer(self, stamp_ns: int, position_m: np.ndarray, velocity_m_s: np.ndarray
                     ) -> None:
        """
        Use geocentric position (3,) m and velocity (3,) m/s on ICRF axes for aberration.

        It is propagated for ten minutes. ValueError for what is not an orbit about the Earth.
        """
        self.motion.add_state(checked_stamp(stamp_ns), State(
            vector_of('position_m', position_m), vector_of('velocity_m_s', velocity_m_s),
            np.zeros((3, 3))))

    def process(self, stamp_ns: int, image: np.ndarray, *, cell: int = 1, exposure_s: float = 0.0
                ) -> FrameResult:
        """
        Process an image (H, W) uint8 or uint16 of the camera.

        Each of its pixels may be the sum of cell x cell pixels of the camera. exposure_s is what
        the camera says of the exposure, 0 where it says nothing: what it said last holds.
        ValueError for another type or another size than that of the camera, and for a stamp that
        is not in ns.
        """
        check_image(image)
        camera, images = self._camera, self._images
        if not images.is_of(image, cell):
            raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px, the camera has '
                             f'{camera.width} x {camera.height}')
        stamp_ns, before = self._begin(stamp_ns)
        pixels = images.given(image, cell, exposure_s)
        self._native.call('st_process_image', stamp_ns, images.image_at, self._result_at)
        del pixels
        found = self._result['extraction']
        self.extraction.windowed = bool(found['windowed'])
        return self._end(stamp_ns, before, centroids_of(
            self._native.listed('st_centroids', native.CENTROID), figures_of(found))
            if self._result['used'] else Centroids.empty())

    def process_centroids(self, stamp_ns: int, centroids: Centroids, windowed: bool = False
                          ) -> FrameResult:
        """
        Process the centroids of an image; ValueError for any other type.

        Where windowed, only stars that the tracker predicted were measured: no check of it.
        """
        of_type('centroids', centroids, Centroids, MADE_BY)
        stamp_ns, before = self._begin(stamp_ns)
        table, exposure_s = native_centroids(centroids), np.array(centroids.exposure_s)
        self._native.call('st_process_centroids', stamp_ns, table.ctypes.data, len(table),
                          exposure_s.ctypes.data, windowed, self._result_at)
        return self._end(stamp_ns, before, centroids)

    def identifier_is_idle(self, stamp_ns: int, windowed: bool = False) -> bool:
        """Return whether the next frame needs no identification."""
        return self.identification.is_idle(stamp_ns, self.tracker.follows, windowed)

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """Identify a frame for the tracker, whether it is due or not, apart from process()."""
        identification, centroids = self.identification.identify(stamp_ns, centroids)
        self.tracker.identified(stamp_ns, centroids, identification.hip)
        return self._icrf(stamp_ns, identification, centroids)

    def _icrf(self, stamp_ns: int, found: Identification, centroids: Centroids) -> Identification:
        """Return an identification of centroids at the time of their frame, in ICRF."""
        identifier = self.identification.identifier
        return icrf_identification(found, centroids, identifier.camera,
                                   self.attitude.sky.at(stamp_ns), identifier.options)

    def _begin(self, stamp_ns: int) -> tuple[int, bool]:
        """
        Return the stamp of a frame, and whether the stars were followed before it.

        The first stamp shows in which unit they are; time that was set back forgets all.
        """
        stamp_ns = checked_stamp(stamp_ns, self._epoch_year if self._newest_ns is None else None)
        if self._newest_ns is not None and self._newest_ns - stamp_ns > RESTART_NS:
            self.reset()
        self._native.look(stamp_ns)
        return stamp_ns, self.tracker.follows

    def _end(self, stamp_ns: int, followed: bool, centroids: Centroids) -> FrameResult:
        """Return the result of a frame that was processed; it has views of one copy of RESULT."""
        result, tracker = self._result.copy(), self.tracker
        if not result['used']:
            tracker.look()
            return FrameResult(
                stamp_ns, centroids, None, Tracks.empty(), None, None, tracker.state,
                f'stamp_ns = {stamp_ns} is not newer than that of the frame before, '
                f'{self._newest_ns}' if stamp_ns else NOT_STAMPED)
        self._newest_ns = stamp_ns
        tracker.look(stamp_ns, result['tracking'])
        tracks, tracked, trusted = tracker.tracks, tracker.attitude, result['attitude']
        attitude = None
        if trusted['valid'] and tracked is not None:
            attitude = Attitude.of_result(trusted, tracked, self._native.listed(
                'st_residuals', np.dtype(float)))
        found = self._identification(stamp_ns, result, followed, centroids)
        reasons = []
        if attitude is None:
            reasons = [status_and_reason(figures_of(result['extraction']))[1],
                       tracker.contradiction or tracker.reason if tracked is None
                       else reason_text(result['reason'])]
            if found is not None and found.attitude is None:
                reasons.append(found.reason)
        return FrameResult(stamp_ns, centroids, found, tracks, tracked, attitude,
                           tracker.state, '; '.join(dict.fromkeys(filter(None, reasons))),
                           self.motion.at(stamp_ns).condition)

    def _identification(self, stamp_ns: int, result: np.ndarray, followed: bool,
                        centroids: Centroids) -> Identification | None:
        """Return the identification of a frame, None where it needed none."""
        stage, found = self.identification, result['identification']
        if not self._identifies:
            # As for the nodes, the state before the frame counts: both work at the same time.
            windowed = bool(result['extraction']['windowed'])
            idle = stage.is_idle(stamp_ns, followed, windowed)
            return None if idle else self.identify(stamp_ns, centroids)
        if found['status'] in _WITHOUT_RESULT:
            return None
        assert isinstance(stage.identifier, PyramidIdentifier)
        stage.body_spots = int(found['body_centroids'])
        self.tracker.look_again()
        seen = centroids_of(self._native.listed('st_searched_centroids', native.CENTROID))
        return self._icrf(int(found['attitude']['stamp_ns']), stage.identifier.result_of(
            seen, found_of(found, self._native, len(seen))), seen)


def _tracks_all_stars(camera: Camera, options: StarTrackerOptions) -> bool:
    """Return whether the star tracker has the stars of the catalogue, with their magnitudes."""
    faintest = camera_catalog(camera).magnitude.max()
    return options.band == BandOptions() and faintest <= options.tracker.magnitude_limit
