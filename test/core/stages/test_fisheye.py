# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fisheyes: from the image to the attitude, and from an image of an unknown one to its camera."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_evaluation.campaign.fisheyes import draw_night, EPOCH_YEAR as NIGHT_YEAR
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.photographs.calibrate import calibrate_files
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.solve import solve_files
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.sim.sky.sources import SkyOptions

# 155 deg, 198 deg from corner to corner.
CAMERA = Camera(1024, 768, 388.0, 388.0, 516.0, 378.0, (-0.02, 0.003, 0.0, 0.0), 'equidistant')
# Of 176 deg, off centre: 2 tan(theta / 2) and sin(theta).
STEREOGRAPHIC = Camera(1024, 1024, 280.0, 280.0, 545.0, 480.0,
                       (1 / 12, 1 / 120, 17 / 20160, 31 / 362880), 'equidistant')
ORTHOGRAPHIC = Camera(1024, 1024, 540.0, 540.0, 545.0, 480.0,
                      (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880), 'equidistant')
EPOCH_YEAR = 2026.5
START_NS = 1_782_000_000 * 10 ** 9
PIXELS = np.stack(np.meshgrid(np.linspace(5, 1018, 23), np.linspace(5, 1018, 23)), -1)


def simulator_of(camera):
    return SkySimulator(
        camera, motion_from_options(MotionOptions(), seed=1), load_catalog().brighter_than(5.5),
        EPOCH_YEAR, sky_options=SkyOptions(aberration=False), seed=1)


def last_of_five(camera, simulator):
    """Return what a tracker with a camera says of the last one of five frames, and that frame."""
    pipeline = StarTracker.with_options(camera, EPOCH_YEAR, StarTrackerOptions(
        aberration=AberrationOptions(aberration='none')))
    for number in range(5):
        frame = simulator.frame(0.1 * number)
        seen = pipeline.process(START_NS + number * 10 ** 8, frame.image)
        if number == 0:
            assert seen.identification.matched > 25
    assert seen.state is TrackerState.TRACKING
    return seen, frame


def test_images_of_a_fisheye_are_identified_and_tracked():
    assert np.degrees(2 * CAMERA.corner_angle_rad) > 190
    seen, frame = last_of_five(CAMERA, simulator_of(CAMERA))
    attitude = seen.attitude
    error = attitude_error(attitude.quaternion, frame.state.q_icrf_from_sensor)
    assert np.linalg.norm(error) / CAMERA.pixel_rad < 0.05
    assert error @ np.linalg.solve(attitude.covariance_sensor, error) < 25
    # Tracked stars are all over the image, some of them beyond a right angle from the axis.
    direction = CAMERA.unproject(seen.tracks.uv)
    assert direction[:, 2].min() < np.cos(np.radians(80))


@pytest.mark.slow
@pytest.mark.parametrize('camera', [STEREOGRAPHIC, ORTHOGRAPHIC])
def test_one_image_of_an_unknown_fisheye_gives_a_camera_to_fly_with(camera, tmp_path):
    simulator, file = simulator_of(camera), tmp_path / 'camera.yaml'
    images = [tmp_path / 'a.png', tmp_path / 'b.png']
    for image, time_s in zip(images, (100.0, 900.0)):
        other = simulator.frame(time_s)
        cv2.imwrite(str(image), other.image)
    calibrate_files(images[:1], file, epoch_year=EPOCH_YEAR, distortion_model='equidistant')
    found = load_camera(file)
    # A principal point off is an attitude off, which the stars then have too.
    true, own = camera.unproject(PIXELS.reshape(-1, 2)), found.unproject(PIXELS.reshape(-1, 2))
    seen = (true[:, 2] > np.cos(np.radians(88))) & np.isfinite(own).all(axis=1)
    assert np.count_nonzero(seen) > 350
    turn, _ = Rotation.align_vectors(own[seen], true[seen])
    off_px = found.project(turn.apply(true[seen])) - PIXELS.reshape(-1, 2)[seen]
    assert np.linalg.norm(off_px, axis=1).max() < 0.1
    # Another image, and a tracker with that camera.
    row, = solve_files(images[1:], camera_file=file, epoch_year=EPOCH_YEAR).rows
    assert row['solved'] and row['matched'] > 30
    error = attitude_error(np.array(row['quaternion']), other.state.q_icrf_from_sensor)
    assert np.linalg.norm(error) < 0.1 * found.pixel_rad
    result, frame = last_of_five(found, simulator)
    error = attitude_error(result.attitude.quaternion, frame.state.q_icrf_from_sensor)
    assert np.linalg.norm(error) < 0.1 * found.pixel_rad


@pytest.mark.slow
@pytest.mark.parametrize('projection, seed, before', [
    ('equidistant', [77, 25, 11], 0), *(pytest.param(*case, marks=pytest.mark.long) for case in (
        ('equisolid', [77, 31, 9], 0), ('orthographic', 721, 3)))])
def test_a_fisheye_of_which_another_lens_explains_a_part_is_a_fisheye(projection, seed, before):
    """The brightest stars fit a lens of 95, 113 and 62 deg that is off by 30 px and more."""
    rng = np.random.default_rng(seed)
    night = [draw_night(rng, projection) for _ in range(before + 1)][-1]
    solution = PhotographSolver(NIGHT_YEAR).solve_lists([night.centroids], night.shape)
    apart = np.linalg.norm(solution.sky.pixels(night.direction) - night.uv, axis=1)
    assert np.nanmedian(apart) < 2 and np.isnan(apart).mean() < 0.1
