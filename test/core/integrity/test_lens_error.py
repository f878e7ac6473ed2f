# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of the lens that stay from frame to frame, separated from noise."""

import numpy as np
import pytest
from skies import CAMERA
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.integrity.consistency import Residuals
from startracker_ros.core.integrity.lens_error import LensError
from startracker_ros.core.integrity.systematic_errors import lens_covariance
from startracker_ros.core.maths.rotation import rotation_vector_from_quaternion
from startracker_ros.core.track.motion_models import image_jacobian

SIGMA_PX = np.linspace(0.03, 0.2, 30)


def learnt(lens_px, frames, seed, turn_rad=0.0, scale=0.0):
    """Return the error learnt of stars with noise, an error that stays and a turn of all."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform(10, 1013, (30, 2))
    flow = image_jacobian(CAMERA, CAMERA.unproject(uv))
    stays = rng.normal(0, lens_px, (30, 2)) + flow @ np.full(3, turn_rad)
    away = uv - [CAMERA.cx, CAMERA.cy]
    stays += scale * away
    error = SIGMA_PX[:, None, None] ** 2 * np.eye(2)
    lens = LensError(CAMERA)
    for _ in range(frames):
        seen = np.sort(rng.choice(30, 27, replace=False))
        # The lens that was learnt so far has predicted the stars.
        residual = stays - lens.scale * away + rng.normal(0, 1, (30, 2)) * SIGMA_PX[:, None]
        lens.add(seen, Residuals(uv[seen], residual[seen], error[seen], flow[seen],
                                 np.zeros((27, 2))))
    return lens


def test_noise_is_no_error_of_the_lens():
    assert np.mean([learnt(0.0, 100, seed).value_px > 0 for seed in range(100)]) <= 0.01
    assert not any(learnt(0.0, 50, seed, turn_rad=1e-4).value_px for seed in range(20))


@pytest.mark.parametrize('lens_px', [0.05, 0.2])
def test_what_stays_is_measured(lens_px):
    values = np.array([learnt(lens_px, 100, seed).value_px for seed in range(40)])
    assert np.sqrt(np.mean(values ** 2)) == pytest.approx(lens_px, rel=0.15)


def test_a_scale_is_measured_and_is_no_error_of_single_stars():
    lenses = [learnt(0.0, 60, seed, scale=1e-3) for seed in range(20)]
    assert np.mean([lens.scale for lens in lenses]) == pytest.approx(1e-3, rel=0.02)
    assert np.std([lens.scale for lens in lenses]) == pytest.approx(
        np.mean([lens.scale_sigma for lens in lenses]), rel=0.5)
    assert all(lens.lens.fx == (1 + lens.scale) * CAMERA.fx for lens in lenses)
    assert np.mean([lens.value_px > 0 for lens in lenses]) <= 0.1
    assert not any(learnt(0.0, 60, seed).scale for seed in range(20))


def test_the_turn_by_a_scale_is_that_of_a_fit_to_scaled_stars():
    rng = np.random.default_rng(5)
    uv = rng.uniform(10, 700, (15, 2))
    sensor, sigma = CAMERA.unproject(uv), CAMERA.pixel_rad * rng.uniform(0.03, 0.3, 15)
    axis = np.array([CAMERA.cx, CAMERA.cy])
    turn = rotation_vector_from_quaternion(estimate_attitude(
        CAMERA.unproject(axis + (uv - axis) * (1 + 1e-3)), sensor, sigma).quaternion)
    covariance = lens_covariance(0.0, 1e-3, sensor, sigma)
    np.testing.assert_allclose(covariance, np.outer(turn, turn), rtol=0.03,
                               atol=1e-2 * (turn @ turn))


def test_the_covariance_is_that_of_fits_with_the_same_error_in_each_frame():
    rng = np.random.default_rng(2)
    sensor = CAMERA.unproject(rng.uniform(10, 1013, (20, 2)))
    sigma = CAMERA.pixel_rad * rng.uniform(0.03, 0.3, 20)
    lens_rad, errors = 0.1 * CAMERA.pixel_rad, []
    for _ in range(2000):
        shifted = sensor + rng.normal(0, lens_rad, sensor.shape)
        shifted /= np.linalg.norm(shifted, axis=1, keepdims=True)
        errors.append(rotation_vector_from_quaternion(
            estimate_attitude(shifted, sensor, sigma).quaternion))
    covariance = lens_covariance(lens_rad, 0.0, sensor, sigma)
    np.testing.assert_allclose(np.diag(np.cov(np.transpose(errors))), np.diag(covariance),
                               rtol=0.15)
