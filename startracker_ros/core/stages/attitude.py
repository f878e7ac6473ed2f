# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which attitude goes out: that of the star tracker, or of single frames, if it can be trusted."""

from dataclasses import replace

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.attitude.result import SOLVERS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentSky
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.integrity.protection import ProtectionOptions
from startracker_ros.core.integrity.reasons import reason_text
from startracker_ros.core.integrity.validation import TrustedAttitude, ValidationOptions
from startracker_ros.core.native_tracker import (
    attitude_of, MOST_CENTROIDS, native_centroids, native_identified,
    native_sky, NativeTracker, ObserverInput, set_options, TRUSTS)
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks


class AttitudeStage:
    """
    Turns tracks or identified stars into the published attitude, or a reason for none.

    The attitude is that of the sensor in ICRF where motion is that of the observer; without one
    the observer is at rest. sky has the stars as that observer sees them: a new one, unless
    that of a star tracker serves both. The sign of the quaternion is continuous from one
    accepted attitude to the next.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: ValidationOptions = ValidationOptions(),
                 motion: ObserverMotion | None = None, sky: ApparentSky | None = None,
                 protection: ProtectionOptions = ProtectionOptions()) -> None:
        self.sky = sky or ApparentSky(camera_stars(camera, epoch_year), motion)
        self._config = native.defaults()
        self._config['stages'] = TRUSTS
        self._config['capacities']['centroids'] = MOST_CENTROIDS
        self._set(options, protection)
        self._tracker = NativeTracker(
            self._config, camera.native, native_sky(self.sky.onboard))
        self._observers = ObserverInput(self._tracker, motion)
        self._trusted, self._tracked = (np.zeros((), kind) for kind in (
            native.TRUSTED, native.ATTITUDE))

    def _set(self, options: ValidationOptions, protection: ProtectionOptions) -> None:
        for each in (options, protection):
            set_options(self._config['trust'], each, solver=SOLVERS)

    def set_limits(self, options: ValidationOptions,
                   protection: ProtectionOptions = ProtectionOptions()) -> None:
        """Use other options from the next frame on."""
        self._set(options, protection)
        self._tracker.change_options(self._config)

    def reset(self) -> None:
        """Forget the sign of the last quaternion."""
        self._tracker.call('st_reset')

    def from_tracks(self, stamp_ns: int, tracks: Tracks, tracked: TrackedAttitude | None
                    ) -> TrustedAttitude:
        """Return the attitude of the star tracker, if the tracks it comes with fit it."""
        own, known = self._tracked, tracked
        own['valid'] = known is not None
        if known is not None:
            own['quaternion'] = known.attitude.quaternion
            own['covariance_rad2'] = known.attitude.covariance_sensor
            own['chi2'] = known.attitude.chi2
        trusted = self._by_tracks(stamp_ns, tracks, own)
        if known is not None and trusted.attitude is not None:
            trusted = replace(trusted, attitude=replace(
                trusted.attitude, budget=known.attitude.budget))
        return trusted

    def from_tracks_alone(self, stamp_ns: int, tracks: Tracks) -> TrustedAttitude:
        """Return the attitude solved from tracks, of a tracker that has no attitude of its own."""
        return self._by_tracks(stamp_ns, tracks, None)

    def _by_tracks(self, stamp_ns: int, tracks: Tracks, tracked: np.ndarray | None
                   ) -> TrustedAttitude:
        table = tracks.table()
        self._observers.look(stamp_ns)
        self._tracker.call('st_trust', stamp_ns, table.ctypes.data, len(table),
                           None if tracked is None else tracked.ctypes.data,
                           self._trusted.ctypes.data)
        return self._result()

    def from_stars(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray
                   ) -> TrustedAttitude:
        """Return the attitude solved from one identified frame, hip (N,) 0 where unknown."""
        table = native_centroids(centroids)
        identified = native_identified(hip, len(table))
        self._observers.look(stamp_ns)
        self._tracker.call('st_trust_stars', stamp_ns, table.ctypes.data, identified.ctypes.data,
                           len(table), self._trusted.ctypes.data)
        return self._result()

    def _result(self) -> TrustedAttitude:
        """Return the result of the last call."""
        found, reason = self._trusted['attitude'], reason_text(self._trusted['reason'])
        if not found['valid']:
            return TrustedAttitude(None, reason)
        return TrustedAttitude(
            replace(attitude_of(found), residual_rad=self._tracker.listed(
                'st_residuals', np.dtype(float))), reason, found['protection_rad'].copy())
