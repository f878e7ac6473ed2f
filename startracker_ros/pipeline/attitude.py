"""Which attitude goes out: that of the star tracker, or of single frames, if it can be trusted."""

import numpy as np
from startracker_ros.attitude.validation import (
    AttitudeValidator, TrustedAttitude, ValidationOptions)
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import onboard_catalog
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.track.tracks import TrackedAttitude, Tracks


class AttitudeStage:
    """Turns tracks or identified stars into the published attitude, or a reason for none."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: ValidationOptions = ValidationOptions()) -> None:
        self._validator = AttitudeValidator(
            camera, onboard_catalog(load_catalog(), camera, epoch_year), options)

    def reset(self) -> None:
        """Forget the sign of the last quaternion."""
        self._validator.reset()

    def warm_up(self) -> None:
        """Load what solving needs, so that the first frame need not wait for it."""
        self._validator.warm_up()

    def from_tracks(self, tracks: Tracks, tracked: TrackedAttitude | None) -> TrustedAttitude:
        """Return the attitude of the star tracker, if the tracks it comes with fit it."""
        if tracked is None:
            return TrustedAttitude(None, 'the star tracker has none')
        used = tracks.usable
        return self._validator.check(tracked.attitude, tracks.uv[used], tracks.hip[used])

    def from_tracks_alone(self, tracks: Tracks) -> TrustedAttitude:
        """Return the attitude solved from tracks, of a tracker that has no attitude of its own."""
        used = tracks.usable
        return self._validator.solve(
            tracks.uv[used], tracks.hip[used], tracks.position_sigma_px[used])

    def from_stars(self, centroids: Centroids, hip: np.ndarray) -> TrustedAttitude:
        """Return the attitude solved from one identified frame, hip (N,) 0 where unknown."""
        return self._validator.solve(centroids.uv, hip, centroids.sigma_px)
