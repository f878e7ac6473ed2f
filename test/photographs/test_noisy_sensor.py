# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of short exposures whose stars are hardly above the noise, or above a level."""

import numpy as np
import pytest
from startracker_ros.core.camera.levels import colour_levels
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.maths.rotation import (
    attitude_error, matrix_from_quaternion, random_attitude)
from startracker_ros.io.images.images import photograph_of
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.sim.sky.detector import Detector, DetectorOptions

CAMERA = Camera.from_fov(696, 520, 6.1)
EPOCH_YEAR = 2020.0
FRAMES = 10
# Background and noise are cut off at zero. One of them has a noise far below a level.
NOISY = DetectorOptions(
    psf_sigma_px=0.7, exposure_s=0.05, zero_flux_e_s=2.5e6, background_e=5.0, read_noise_e=7.0,
    gain_e_per_dn=1.0, bias_dn=0.0, bit_depth=8, dark_current_e_s=20.0, hot_pixel_fraction=1e-5,
    row_noise_dn=0.5)
COARSE = DetectorOptions(
    psf_sigma_px=0.7, exposure_s=0.1, zero_flux_e_s=2.5e6, background_e=5.0, read_noise_e=7.0,
    gain_e_per_dn=25.0, bias_dn=0.0, bit_depth=8, dark_current_e_s=20.0, hot_pixel_fraction=1e-5)


def frames(options, seed):
    """Yield attitude and image of frames of one sensor, each of another part of the sky."""
    rng, detector = np.random.default_rng(seed), Detector(CAMERA, options, seed=seed)
    stars = load_catalog().brighter_than(9.0)
    direction = stars.directions(EPOCH_YEAR)
    for _ in range(FRAMES):
        quaternion = random_attitude(rng)
        seen = direction @ matrix_from_quaternion(quaternion)
        near = seen[:, 2] > np.cos(CAMERA.corner_angle_rad)
        yield quaternion, detector.render(
            CAMERA.project(seen[near]), stars.magnitude[near], rng)


@pytest.fixture(scope='module')
def solver():
    return PhotographSolver(EPOCH_YEAR)


@pytest.mark.parametrize('options, least', [(NOISY, 7), (COARSE, 7)], ids=['noisy', 'coarse'])
def test_frames_of_a_noisy_sensor_are_solved(solver, options, least):
    solved = 0
    for truth, image in frames(options, 1):
        solution = solver.solve(image, CAMERA)
        if solution.solved:
            error = attitude_error(solution.identification.attitude.quaternion, truth)
            assert np.linalg.norm(error) < np.radians(0.05)
            solved += 1
    assert solved >= least
