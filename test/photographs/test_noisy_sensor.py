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


def test_peaks_need_no_threshold():
    """A star of three levels in an image of zeros, and the highest of noise, 30 of them."""
    image = np.zeros((120, 160), np.uint8)
    image[40, 60:62] = 3
    image[41, 60] = 1
    peaks = CentroidExtractor().find_highest_peaks(image)
    assert len(peaks) == 1
    np.testing.assert_allclose(peaks.uv[0], [60.45, 40.1], atol=0.2)
    noise = np.random.default_rng(2).normal(30, 5, (400, 400))
    noise[200, 100:102] += 40
    peaks = CentroidExtractor().find_highest_peaks(noise.astype(np.uint16))
    assert len(peaks) == 30 and (np.diff(peaks.flux) <= 0).all()
    assert np.linalg.norm(peaks.uv[0] - [100.5, 200.0]) < 0.3


def test_noise_has_no_attitude(solver):
    """Each image of noise has 30 peaks."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        image = rng.normal(-2, 6, (CAMERA.height, CAMERA.width)).clip(0, 255).astype(np.uint8)
        assert len(CentroidExtractor().find_highest_peaks(image)) == 30
        assert not solver.solve(image, CAMERA).solved


def test_colours_are_summed_where_their_mean_has_no_noise():
    rng = np.random.default_rng(4)
    dark = (rng.random((60, 80, 3)) < 0.1).astype(np.uint8)
    dark[30, 40] = [200, 255, 90]
    photograph = photograph_of(dark)
    np.testing.assert_array_equal(photograph.image, colour_levels(dark))
    assert photograph.step == pytest.approx(1 / 3) and photograph.image[30, 40] == 1023
    bright = rng.integers(40, 60, (60, 80, 3)).astype(np.uint8)
    assert photograph_of(bright).image.dtype == np.uint8
    grey = np.repeat(dark[..., :1], 3, axis=2)
    assert photograph_of(grey).image.dtype == np.uint8
