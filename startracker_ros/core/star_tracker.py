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
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.parameters import options_of_keywords, StarTrackerOptions
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.core.values import of_type, vector_of


class StarTracker:
    """
    Images or centroids of one camera in, attitude out: the stages of the nodes in one process.

    Frames come in the order of their stamps, UNIX time in ns of the middle of the exposure. A
    frame that is not newer than the one before is not used, and its result has the reason; one
    that is older by more than a second begins anew, as after reset().

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
        epoch_year = epoch.year
        self.extraction = ExtractionStage(options.extraction, options.search)
        self.identification = IdentificationStage(
            camera, epoch_year, options.identification, options.check, gyro=options.gyro,
            band=options.band)
        self.motion = ObserverMotion(options.aberration, epoch)
        self.tracker = make_track_filter(
            camera, epoch_year, options.tracker, options.gyro, self.motion, options.band)
        self.attitude = AttitudeStage(
            camera, epoch_year, options.validation, self.motion,
            self.tracker.sky if _tracks_all_stars(camera, options) else None,
            options.protection)
        self._newest_ns: int | None = None

    def reset(self) -> None:
        """Forget all frames and rates: LOST, as after the start."""
        self.extraction.reset()
        self.identification.reset()
        self.tracker.reset()
        self.attitude.reset()
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

        It is propagated for ten minutes. ValueError for what is no orbit about the Earth.
        """
        self.motion.add_state(checked_stamp(stamp_ns), State(
            vector_of('position_m', position_m), vector_of('velocity_m_s', velocity_m_s),
            np.zeros((3, 3))))

    def process(self, stamp_ns: int, image: np.ndarray) -> FrameResult:
        """
        Process an image (H, W) uint8 or uint16 of the camera.

        ValueError for another type or another size than that of the camera, and for a stamp that
        is not in ns.
        """
        check_image(image)
        camera = self._camera
        if image.shape != (camera.height, camera.width):
            raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px, the camera has '
                             f'{camera.width} x {camera.height}')
        stamp_ns = self._checked(stamp_ns)
        late = self._late(stamp_ns)
        if late:
            return self._unused(stamp_ns, Centroids.empty(), late)
        extraction = self.extraction.process(stamp_ns, image, self.tracker.predicted)
        return self._update(stamp_ns, extraction.centroids, self.extraction.windowed,
                            extraction.reason)

    def process_centroids(self, stamp_ns: int, centroids: Centroids, windowed: bool = False
                          ) -> FrameResult:
        """
        Process the centroids of an image; ValueError for any other type.

        Where windowed, only stars that the tracker predicted were measured: no check of it.
        """
        of_type('centroids', centroids, Centroids, MADE_BY)
        stamp_ns = self._checked(stamp_ns)
        late = self._late(stamp_ns)
        if late:
            return self._unused(stamp_ns, centroids, late)
        return self._update(stamp_ns, centroids, windowed, '')

    def identifier_is_idle(self, stamp_ns: int, windowed: bool = False) -> bool:
        """Return whether the next frame needs no identification."""
        return self.identification.is_idle(stamp_ns, self.tracker.follows, windowed)

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """Identify a frame for the tracker."""
        identification, centroids = self.identification.identify(stamp_ns, centroids)
        self.tracker.identified(stamp_ns, centroids, identification.hip)
        identifier = self.identification.identifier
        return icrf_identification(identification, centroids, identifier.camera,
                                   self.attitude.sky.at(stamp_ns), identifier.options)

    def _checked(self, stamp_ns: int) -> int:
        """Return the stamp of a frame; the first one shows in which unit they are."""
        return checked_stamp(stamp_ns, self._epoch_year if self._newest_ns is None else None)

    def _late(self, stamp_ns: int) -> str:
        """Return why a frame is not newer, empty if it is; forget all if time was set back."""
        newest_ns = self._newest_ns
        if newest_ns is not None and newest_ns - stamp_ns > RESTART_NS:
            self.reset()
        elif newest_ns is not None and stamp_ns <= newest_ns:
            return (f'stamp_ns = {stamp_ns} is not newer than that of the frame before, '
                    f'{newest_ns}' if stamp_ns else NOT_STAMPED)
        self._newest_ns = stamp_ns
        return ''

    def _unused(self, stamp_ns: int, centroids: Centroids, reason: str) -> FrameResult:
        """Return the result of a frame that is not used."""
        return FrameResult(stamp_ns, centroids, None, Tracks.empty(), None, None,
                           self.tracker.state, reason)

    def _update(self, stamp_ns: int, centroids: Centroids, windowed: bool, extraction_reason: str
                ) -> FrameResult:
        # As for the nodes, the state before the frame counts: both work on it at the same time.
        idle = self.identifier_is_idle(stamp_ns, windowed)
        tracks = self.tracker.update(stamp_ns, centroids) or Tracks.empty()
        tracked = self.tracker.attitude
        trusted = self.attitude.from_tracks(stamp_ns, tracks, tracked)
        attitude: Attitude | None = None
        if trusted.attitude is not None and tracked is not None:
            # Before an identification that may begin anew.
            attitude = Attitude.of(
                stamp_ns, trusted.attitude, tracked, self.tracker.acceleration,
                cross_covariance=self.tracker.cross_covariance,
                protection_rad=trusted.protection_rad)
        found = None if idle else self.identify(stamp_ns, centroids)
        reasons = [extraction_reason]
        if attitude is not None:
            reasons = []
        else:
            reasons.append(self.tracker.contradiction or self.tracker.reason
                           if tracked is None else trusted.reason)
            if found is not None and found.attitude is None:
                reasons.append(found.reason)
        return FrameResult(stamp_ns, centroids, found, tracks, tracked, attitude,
                           self.tracker.state, '; '.join(dict.fromkeys(filter(None, reasons))),
                           self.motion.at(stamp_ns).condition)


def _tracks_all_stars(camera: Camera, options: StarTrackerOptions) -> bool:
    """Return whether the star tracker has the stars of the catalogue, with their magnitudes."""
    faintest = camera_catalog(camera).magnitude.max()
    return options.band == BandOptions() and faintest <= options.tracker.magnitude_limit
