# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stages of a frame on one native tracker, which does them in one call."""

from typing import TYPE_CHECKING

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import Extraction
from startracker_ros.core.centroid.image_tracker import ImageTracker, set_extraction
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.integrity.validation import TrustedAttitude
from startracker_ros.core.native_tracker import (
    EXTRACTS, IDENTIFIES, native_centroids, SkyTracker, TRACKS, TRUSTS)
from startracker_ros.core.stages.attitude import AttitudeStage, set_trust, trusted_of
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.track.target import TargetTracker, TargetTrackOptions
from startracker_ros.core.track.track_filter import set_tracking, TrackFilter

if TYPE_CHECKING:
    from startracker_ros.core.identify.pyramid import PyramidIdentifier
    from startracker_ros.core.stages.parameters import StarTrackerOptions


class FramePath:
    """
    Extraction, tracking and trust of one camera; with an identifier also identification.

    extraction, tracker and attitude are the stages, each of which can be called alone. result is
    the RESULT of the last call for a whole frame. ValueError for a camera that is too large.
    """

    def __init__(self, camera: Camera, epoch_year: float, options: 'StarTrackerOptions',
                 motion: ObserverMotion, identifier: 'PyramidIdentifier | None' = None) -> None:
        self.camera, self.motion = camera, motion
        self.extraction = ExtractionStage(options.extraction, options.search)
        onboard = camera_stars(camera, epoch_year, options.tracker.magnitude_limit, options.band)
        config, patterns = native.defaults(), None
        config['stages'] = EXTRACTS | TRACKS | TRUSTS
        if identifier is not None:
            config['stages'] |= IDENTIFIES
            patterns = identifier.native_patterns()
            for name, value in identifier.native_options.items():
                config['identification'][name] = value
        config['identification']['check_period_s'] = options.check.check_period_s
        set_extraction(config, self.extraction.options)
        set_tracking(config, options.tracker, options.gyro)
        set_trust(config, options.validation, options.protection)
        # All stages have one copy of tracks and attitude.
        self.native = SkyTracker(config, camera, onboard, motion, patterns)
        self.result = np.zeros((), native.RESULT)
        self._result_at = self.result.ctypes.data
        self._images = self.extraction.images = ImageTracker(
            (camera.height, camera.width), self.extraction.options, self.native)
        self.tracker = TrackFilter(camera, onboard, options.tracker, options.gyro, motion,
                                   self.native, self.result['tracking'])
        self.attitude = AttitudeStage(
            camera, epoch_year, options.validation, motion,
            self.tracker.sky if _tracks_all_stars(camera, options) else None,
            options.protection, self.native)

    def is_of(self, image: np.ndarray, cell: int = 1) -> bool:
        """Return whether an image is one of the camera, of which each pixel is cell x cell."""
        return self._images.is_of(image, cell)

    def process(self, stamp_ns: int, image: np.ndarray, cell: int = 1, exposure_s: float = 0.0
                ) -> bool:
        """Process an image of the camera; return whether it is newer than the one before."""
        self.native.look(stamp_ns)
        pixels = self._images.given(image, cell, exposure_s)
        self.native.call('st_process_image', stamp_ns, self._images.image_at, self._result_at)
        del pixels
        self.extraction.windowed = bool(self.result['extraction']['windowed'])
        return bool(self.result['used'])

    def process_centroids(self, stamp_ns: int, centroids: Centroids, windowed: bool) -> bool:
        """Process the centroids of an image; return whether it is newer than the one before."""
        self.native.look(stamp_ns)
        table, exposure_s = native_centroids(centroids), np.array(centroids.exposure_s)
        self.native.call('st_process_centroids', stamp_ns, table.ctypes.data, len(table),
                         exposure_s.ctypes.data, windowed, self._result_at)
        return bool(self.result['used'])

    def extracted(self) -> Extraction:
        """Return what was found in the last image."""
        return Extraction.of(self._images.found(self.result['extraction']))

    def trusted(self) -> TrustedAttitude:
        """Return the attitude of the last frame, without residuals, or why there is none."""
        return trusted_of(self.result)


def _tracks_all_stars(camera: Camera, options: 'StarTrackerOptions') -> bool:
    """Return whether the star tracker has the stars of the catalogue, with their magnitudes."""
    faintest = camera_catalog(camera).magnitude.max()
    return options.band == BandOptions() and faintest <= options.tracker.magnitude_limit


def make_frame_path(camera: Camera, epoch_year: float, options: 'StarTrackerOptions',
                    target: TargetTrackOptions, motion: ObserverMotion
                    ) -> tuple[TrackFilter, TargetTracker, FramePath]:
    """Return a path without identification: its tracker, that of a target, and the path."""
    path = FramePath(camera, epoch_year, options, motion)
    return path.tracker, TargetTracker(camera, path.tracker.sky, target), path
