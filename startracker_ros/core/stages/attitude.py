# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which attitude goes out: that of the star tracker, or of single frames, if it can be trusted."""

from dataclasses import replace

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.attitude.result import with_correlated_error
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentSky
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import synthetic_field
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.integrity.protection import ProtectionOptions
from startracker_ros.core.integrity.validation import (
    AttitudeValidator, TrustedAttitude, ValidationOptions)
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks


class AttitudeStage:
    """
    Turns tracks or identified stars into the published attitude, or a reason for none.

    The attitude is that of the sensor in ICRF where motion is that of the observer; without one
    the observer is at rest. sky has the stars as that observer sees them: a new one, unless
    that of a star tracker serves both.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: ValidationOptions = ValidationOptions(),
                 motion: ObserverMotion | None = None, sky: ApparentSky | None = None,
                 protection: ProtectionOptions = ProtectionOptions()) -> None:
        self._camera, self._epoch_year = camera, epoch_year
        self.sky = sky or ApparentSky(camera_stars(camera, epoch_year), motion)
        self._validator = AttitudeValidator(camera, options, protection)

    def set_limits(self, options: ValidationOptions,
                   protection: ProtectionOptions = ProtectionOptions()) -> None:
        """Use other options from the next frame on."""
        self._validator.set_limits(options, protection)

    def reset(self) -> None:
        """Forget the sign of the last quaternion."""
        self._validator.reset()

    def warm_up(self) -> None:
        """Load what a frame needs by solving a synthetic field."""
        centroids, hip = synthetic_field(self.sky.onboard, self._camera)
        stamp_ns = stamp_from_epoch_year(self._epoch_year)
        solved = self.from_stars(stamp_ns, centroids, hip)
        if solved.attitude is not None:
            checked = self._validator.check(
                self.sky.at(stamp_ns), solved.attitude, centroids.uv, hip, centroids.sigma_px,
                np.zeros(len(hip)))
            _ = checked.protection_rad  # computed when it is read
        self.reset()

    def from_tracks(self, stamp_ns: int, tracks: Tracks, tracked: TrackedAttitude | None
                    ) -> TrustedAttitude:
        """Return the attitude of the star tracker, if the tracks it comes with fit it."""
        if tracked is None:
            return TrustedAttitude(None, 'the star tracker has none')
        used = tracks.usable
        return self._validator.check(
            self.sky.at(stamp_ns), tracked.attitude, tracks.uv[used], tracks.hip[used],
            tracks.sigma_px[used], tracks.residual_px[used])

    def from_tracks_alone(self, stamp_ns: int, tracks: Tracks) -> TrustedAttitude:
        """Return the attitude solved from tracks, of a tracker that has no attitude of its own."""
        used = tracks.usable
        return self._validator.solve(
            self.sky.at(stamp_ns), tracks.uv[used], tracks.hip[used], tracks.covariance[used])

    def from_stars(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray
                   ) -> TrustedAttitude:
        """Return the attitude solved from one identified frame, hip (N,) 0 where unknown."""
        solved = self._validator.solve(
            self.sky.at(stamp_ns), centroids.uv, hip, centroids.covariance)
        if solved.attitude is None:
            return solved
        return replace(solved, attitude=with_correlated_error(
            solved.attitude, centroids.correlated_error, self._camera))
