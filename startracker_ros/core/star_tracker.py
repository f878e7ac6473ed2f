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
from startracker_ros.core.centroid.centroids import Centroids, MADE_BY
from startracker_ros.core.centroid.extraction import check_image
from startracker_ros.core.centroid.image_tracker import (
    centroids_of, figures_of)
from startracker_ros.core.centroid.reasons import status_and_reason
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.star_matcher import found_of, STATUSES
from startracker_ros.core.integrity.reasons import reason_text
from startracker_ros.core.stages.frame_path import FramePath
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.parameters import options_of_keywords, StarTrackerOptions
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.core.values import of_type, vector_of

_WITHOUT_RESULT = [STATUSES.index(name) for name in ('not_due', 'searching')]


class StarTracker:
    """
    Images or centroids of one camera in, attitude out: the stages of the nodes in one process.

    Frames come in the order of their stamps, UNIX time in ns of the middle of the exposure. A
    frame that is not newer than the one before is not used, and its result has the reason; one
    that is older by more than a second restarts the tracker, as `reset()` does.

    Stars are identified by their directions without aberration; every attitude that goes out is
    fitted to the apparent directions of its stamp and is that of the sensor in ICRF.

    Args:
        camera: Lens of the images.
        epoch_year: Epoch of the star places: Julian year, datetime or text as
            `'2026-07-02T12:00:00Z'`, UTC without a zone.
        **options: Parameters of the nodes by name. One that several nodes have is set in all of
            them; where it means different things, name the node:
            `star_identifier={'method': 'quad'}`.

    Raises:
        CameraError: A field of view that the method cannot handle.
        ValueError: A wrong argument or option; the text names those there are.

    """

    def __init__(self, camera: Camera, epoch_year: float | datetime | str, **options: Any
                 ) -> None:
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
        self.identification = IdentificationStage(
            camera, epoch.year, options.identification, options.check, gyro=options.gyro,
            band=options.band)
        self.motion = ObserverMotion(options.aberration, epoch)
        identifier = self.identification.identifier
        # Other methods identify in Python.
        pyramid = identifier if type(identifier) is PyramidIdentifier else None
        self._identifies = pyramid is not None
        self._path = FramePath(camera, epoch.year, options, self.motion, pyramid)
        self.extraction, self.tracker = self._path.extraction, self._path.tracker
        self.attitude = self._path.attitude
        self._newest_ns: int | None = None

    def reset(self) -> None:
        """Forget all frames and rates; the state is LOST, as at the start."""
        self.extraction.windowed = False
        self.identification.reset()
        self.tracker.reset()
        self._newest_ns = None

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """
        Use a rate of a gyro, before the frame that follows it.

        Args:
            stamp_ns: UNIX time in ns, int, up to which it was measured.
            rate_rad_s: Angular velocity (3,) about sensor axes, rad/s.

        Raises:
            ValueError: Not three finite numbers, or more than any gyro measures, as deg/s.

        """
        stamp_ns, rate_rad_s = checked_stamp(stamp_ns), checked_rate(rate_rad_s)
        self.tracker.add_rate(stamp_ns, rate_rad_s)
        self.identification.add_rate(stamp_ns, rate_rad_s)

    def add_observer(self, stamp_ns: int, position_m: np.ndarray, velocity_m_s: np.ndarray
                     ) -> None:
        """
        Use position and velocity of the spacecraft for aberration; propagated for ten minutes.

        Args:
            stamp_ns: UNIX time in ns, int.
            position_m: Geocentric position (3,) on ICRF axes, m.
            velocity_m_s: Geocentric velocity (3,) on ICRF axes, m/s.

        Raises:
            ValueError: Not three finite numbers, or not an orbit about the Earth.

        """
        self.motion.add_state(checked_stamp(stamp_ns), State(
            vector_of('position_m', position_m), vector_of('velocity_m_s', velocity_m_s),
            np.zeros((3, 3))))

    def process(self, stamp_ns: int, image: np.ndarray, *, cell: int = 1, exposure_s: float = 0.0
                ) -> FrameResult:
        """
        Process one image.

        Args:
            stamp_ns: UNIX time in ns, int, of the middle of the exposure.
            image: Array (H, W) uint8 or uint16, of the size of the camera.
            cell: Pixels a side of the camera that each pixel of the image is the sum of.
            exposure_s: Exposure time that the camera reports, s; 0 keeps the last one.

        Returns:
            `FrameResult` of this frame.

        Raises:
            ValueError: An image of another type or size, or a stamp that is not in ns.

        """
        check_image(image)
        camera, path = self._camera, self._path
        if not path.is_of(image, cell):
            raise ValueError(f'image of {image.shape[1]} x {image.shape[0]} px, the camera has '
                             f'{camera.width} x {camera.height}')
        stamp_ns, before = self._begin(stamp_ns)
        used = path.process(stamp_ns, image, cell, exposure_s)
        return self._end(stamp_ns, before, centroids_of(
            path.native.listed('st_centroids', native.CENTROID),
            figures_of(path.result['extraction'])) if used else Centroids.empty())

    def process_centroids(self, stamp_ns: int, centroids: Centroids, windowed: bool = False
                          ) -> FrameResult:
        """
        Process the centroids of one image.

        Args:
            stamp_ns: UNIX time in ns, int, of the middle of the exposure.
            centroids: Detections, brightest first; an empty list is a frame without stars.
            windowed: Whether only predicted stars were measured, so that they check nothing.

        Returns:
            `FrameResult` of this frame.

        Raises:
            ValueError: Not Centroids, or a stamp that is not in ns.

        """
        of_type('centroids', centroids, Centroids, MADE_BY)
        stamp_ns, before = self._begin(stamp_ns)
        self._path.process_centroids(stamp_ns, centroids, windowed)
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
        return stamp_ns, self.tracker.follows

    def _end(self, stamp_ns: int, followed: bool, centroids: Centroids) -> FrameResult:
        """Return the result of a frame that was processed; it has views of one copy of RESULT."""
        result, tracker = self._path.result.copy(), self.tracker
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
            attitude = Attitude.of_result(trusted, tracked, self._path.native.listed(
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
        seen = centroids_of(self._path.native.listed('st_searched_centroids', native.CENTROID))
        return self._icrf(int(found['attitude']['stamp_ns']), stage.identifier.result_of(
            seen, found_of(found, self._path.native, len(seen))), seen)
