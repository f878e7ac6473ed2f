# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The trackers of a camera, with the catalogue as that camera sees it."""

from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.target import TargetTracker, TargetTrackOptions
from startracker_ros.core.track.track_filter import TrackFilter


def make_track_filter(camera: Camera, epoch_year: float,
                      options: TrackerOptions = TrackerOptions(),
                      gyro: GyroErrorOptions = GyroErrorOptions(),
                      motion: ObserverMotion | None = None,
                      band: BandOptions = BandOptions()) -> TrackFilter:
    """Return the filter of the tracks, with the shipped catalogue at a Julian year."""
    onboard = camera_stars(camera, epoch_year, options.magnitude_limit, band)
    return TrackFilter(camera, onboard, options, gyro, motion)


def make_trackers(camera: Camera, epoch_year: float, options: TrackerOptions,
                  gyro: GyroErrorOptions, target: TargetTrackOptions, motion: ObserverMotion,
                  band: BandOptions) -> tuple[TrackFilter, TargetTracker]:
    """Return the filter of the tracks of stars, and the tracker of a target among them."""
    tracker = make_track_filter(camera, epoch_year, options, gyro, motion, band)
    return tracker, TargetTracker(camera, tracker.sky, target)
