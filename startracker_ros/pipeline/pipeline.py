"""Identifier, star tracker and attitude one after the other: the pipeline without processes."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.attitude.validation import (
    AttitudeValidator, TrustedAttitude, ValidationOptions)
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.identification import Identification, IdentificationOptions
from startracker_ros.identify.methods import make_identifier
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.tracker import StarTracker, TrackerState
from startracker_ros.track.tracks import TrackedAttitude, Tracks


@dataclass(frozen=True)
class ReplayedFrame:
    """
    What the stages say of a frame; identification is None while the identifier rests.

    state is that of the tracker after the frame, trusted what attitude_estimator publishes.
    """

    identification: Identification | None
    tracks: Tracks
    tracked: TrackedAttitude | None
    state: TrackerState
    reason: str
    trusted: TrustedAttitude


class Replay:
    """
    The stages of the nodes at their defaults, each frame done before the next one comes.

    The nodes run beside each other, so theirs may take an identification some frames later.
    """

    def __init__(self, camera: Camera, epoch_year: float) -> None:
        catalog = load_catalog()
        options = TrackerOptions()
        self._identifier = make_identifier(camera, epoch_year, IdentificationOptions())
        self._tracker = StarTracker(
            camera, camera_places(catalog, camera, epoch_year, options.magnitude_limit), options)
        self._trust = AttitudeValidator(
            camera, camera_places(catalog, camera, epoch_year), ValidationOptions())

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """Take the rate (3,) of a gyro about sensor axes."""
        self._tracker.add_rate(stamp_ns, rate_rad_s)

    def update(self, stamp_ns: int, centroids: Centroids) -> ReplayedFrame:
        """Take the centroids of a frame, newer than the one before."""
        tracker = self._tracker
        rests = tracker.state is TrackerState.TRACKING
        tracks = tracker.update(stamp_ns, centroids) or Tracks.empty()
        tracked = tracker.attitude
        used = tracks.usable
        trusted = (TrustedAttitude(None, 'the star tracker has none') if tracked is None else
                   self._trust.check(tracked.attitude, tracks.uv[used], tracks.hip[used]))
        identification = None
        if not rests:
            identification = self._identifier.identify(centroids)
            tracker.identified(stamp_ns, centroids, identification.hip)
        return ReplayedFrame(identification, tracks, tracked, tracker.state, tracker.reason,
                             trusted)
