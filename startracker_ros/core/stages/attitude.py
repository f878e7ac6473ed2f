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
    attitude_of, MOST_CENTROIDS, native_centroids, native_identified, set_options, SkyTracker,
    TRUSTS)
from startracker_ros.core.track.tracks import TrackedAttitude, Tracks


class AttitudeStage:
    """
    Turns tracks or identified stars into the published attitude, or a reason for none.

    The attitude is that of the sensor in ICRF where motion is that of the observer; without one
    the observer is at rest. sky has the stars as that observer sees them: a new one, unless
    that of a star tracker serves both, as tracker may. The sign of the quaternion is continuous
    from one accepted attitude to the next.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: ValidationOptions = ValidationOptions(),
                 motion: ObserverMotion | None = None, sky: ApparentSky | None = None,
                 protection: ProtectionOptions = ProtectionOptions(),
                 tracker: SkyTracker | None = None) -> None:
        self.sky = sky or ApparentSky(camera_stars(camera, epoch_year), motion)
        if tracker is None:
            config = native.defaults()
            config['stages'] = TRUSTS
            set_trust(config, options, protection)
            tracker = SkyTracker(config, camera, self.sky.onboard, motion)
        self._tracker = tracker
        self._trusted, self._tracked = (np.zeros((), kind) for kind in (
            native.TRUSTED, native.ATTITUDE))

    def set_limits(self, options: ValidationOptions,
                   protection: ProtectionOptions = ProtectionOptions()) -> None:
        """Use other options from the next frame on."""
        set_trust(self._tracker.config, options, protection)
        self._tracker.change_options()

    def reset(self) -> None:
        """Forget the sign of the last quaternion."""
        self._tracker.reset()

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
        self._tracker.look(stamp_ns)
        self._tracker.call('st_trust', stamp_ns, table.ctypes.data, len(table),
                           None if tracked is None else tracked.ctypes.data,
                           self._trusted.ctypes.data)
        return self._result()

    def from_stars(self, stamp_ns: int, centroids: Centroids, hip: np.ndarray
                   ) -> TrustedAttitude:
        """Return the attitude solved from one identified frame, hip (N,) 0 where unknown."""
        table = native_centroids(centroids)
        identified = native_identified(hip, len(table))
        self._tracker.look(stamp_ns)
        self._tracker.call('st_trust_stars', stamp_ns, table.ctypes.data, identified.ctypes.data,
                           len(table), self._trusted.ctypes.data)
        return self._result()

    def _result(self) -> TrustedAttitude:
        """Return the result of the last call."""
        trusted = trusted_of(self._trusted)
        return trusted if trusted.attitude is None else replace(trusted, attitude=replace(
            trusted.attitude, residual_rad=self._tracker.listed(
                'st_residuals', np.dtype(float))))


def trusted_of(result: np.ndarray) -> TrustedAttitude:
    """Return the attitude of a native result, without residuals, or why there is none."""
    found, reason = result['attitude'].copy(), reason_text(result['reason'])
    return (TrustedAttitude(attitude_of(found), reason, found['protection_rad'])
            if found['valid'] else TrustedAttitude(None, reason))


def set_trust(config: np.ndarray, options: ValidationOptions, protection: ProtectionOptions
              ) -> None:
    """Set the limits of a CONFIG."""
    config['capacities']['centroids'] = MOST_CENTROIDS
    for each in (options, protection):
        set_options(config['trust'], each, solver=SOLVERS)
