"""The trackers of a camera, with the catalogue as that camera sees it."""

from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.target import TargetTracker, TargetTrackOptions
from startracker_ros.track.tracker import StarTracker


def make_star_tracker(camera: Camera, epoch_year: float,
                      options: TrackerOptions = TrackerOptions(),
                      gyro: GyroErrorOptions = GyroErrorOptions()) -> StarTracker:
    """Return a star tracker with the shipped catalogue at a Julian year."""
    return StarTracker(camera, _tracked_stars(camera, epoch_year, options), options, gyro)


def make_trackers(camera: Camera, epoch_year: float, options: TrackerOptions,
                  gyro: GyroErrorOptions, target: TargetTrackOptions
                  ) -> tuple[StarTracker, TargetTracker]:
    """Return a star tracker, and a tracker of the target among its stars."""
    onboard = _tracked_stars(camera, epoch_year, options)
    return StarTracker(camera, onboard, options, gyro), TargetTracker(camera, onboard, target)


def _tracked_stars(camera: Camera, epoch_year: float, options: TrackerOptions) -> OnboardCatalog:
    return onboard_catalog(load_catalog(), camera, epoch_year, options.magnitude_limit)
