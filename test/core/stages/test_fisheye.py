# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fisheye of 155 deg, 198 deg from corner to corner: from the image to the attitude."""

import numpy as np
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

CAMERA = Camera(1024, 768, 388.0, 388.0, 516.0, 378.0, (-0.02, 0.003, 0.0, 0.0), 'equidistant')
START_NS = 1_782_000_000 * 10 ** 9


def test_images_of_a_fisheye_are_identified_and_tracked():
    assert np.degrees(2 * CAMERA.corner_angle_rad) > 190
    simulator = SkySimulator(
        CAMERA, motion_from_options(MotionOptions(), seed=1), load_catalog().brighter_than(5.5),
        2026.5, sky_options=SkyOptions(aberration=False), seed=1)
    pipeline = StarTracker.with_options(CAMERA, 2026.5, StarTrackerOptions(
        aberration=AberrationOptions(aberration='none')))
    for number in range(5):
        frame = simulator.frame(0.1 * number)
        seen = pipeline.process(START_NS + number * 10 ** 8, frame.image)
        if number == 0:
            assert seen.identification.matched > 25
    assert seen.state is TrackerState.TRACKING
    attitude = seen.attitude
    error = attitude_error(attitude.quaternion, frame.state.q_icrf_from_sensor)
    assert np.linalg.norm(error) / CAMERA.pixel_rad < 0.05
    assert error @ np.linalg.solve(attitude.covariance_sensor, error) < 25
    # Tracked stars are all over the image, some of them beyond a right angle from the axis.
    direction = CAMERA.unproject(seen.tracks.uv)
    assert direction[:, 2].min() < np.cos(np.radians(80))
