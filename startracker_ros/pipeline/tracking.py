"""The trackers of a camera, with the catalogue as that camera sees it."""

from startracker_ros.astro.observer_motion import ObserverMotion
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.deep import camera_catalog
from startracker_ros.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.target import TargetTracker, TargetTrackOptions
from startracker_ros.track.tracker import StarTracker


def make_star_tracker(camera: Camera, epoch_year: float,
                      options: TrackerOptions = TrackerOptions(),
                      gyro: GyroErrorOptions = GyroErrorOptions(),
                      motion: ObserverMotion | None = None) -> StarTracker:
    """Return a star tracker with the shipped catalogue at a Julian year."""
    return StarTracker(camera, _tracked_stars(camera, epoch_year, options), options, gyro, motion)


def make_trackers(camera: Camera, epoch_year: float, options: TrackerOptions,
                  gyro: GyroErrorOptions, target: TargetTrackOptions, motion: ObserverMotion
                  ) -> tuple[StarTracker, TargetTracker]:
    """Return a star tracker, and a tracker of the target among its stars."""
    tracker = make_star_tracker(camera, epoch_year, options, gyro, motion)
    return tracker, TargetTracker(camera, tracker.sky, target)


def _tracked_stars(camera: Camera, epoch_year: float, options: TrackerOptions) -> OnboardCatalog:
    return onboard_catalog(camera_catalog(camera), camera, epoch_year,
                           options.magnitude_limit)
