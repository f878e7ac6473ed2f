# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Torn frames, second images and line times, from residuals and missed stars."""

import numpy as np
import pytest
from skies import CAMERA
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.integrity.consistency import expected_stars, Residuals, RowPattern
from startracker_ros.core.maths.rotation import conjugate, random_attitude, rotate
from startracker_ros.core.track.motion_models import image_jacobian
from startracker_ros.core.track.rolling_shutter import at_frame_time, fit_rate

RATE = np.radians([0.8, -0.4, 0.3])
SIGMA_PX = 0.05


def field(seed=1, count=30):
    rng = np.random.default_rng(seed)
    uv = rng.uniform(10, 1013, (count, 2))
    return rng, uv, image_jacobian(CAMERA, CAMERA.unproject(uv))


def residuals(delay_s, seed=1, extra=0.0):
    """Return the residuals of stars that are delayed, without the rotation that they look like."""
    rng, uv, flow = field(seed)
    velocity = flow @ RATE
    shift = velocity * delay_s(uv[:, 1])[:, None] + extra * (uv - 511.5)
    shift += rng.normal(0, SIGMA_PX, uv.shape)
    turn = np.linalg.lstsq(flow.reshape(-1, 3), shift.reshape(-1), rcond=None)[0]
    error = np.tile(SIGMA_PX ** 2 * np.eye(2), (len(uv), 1, 1))
    return Residuals(uv, shift - flow @ turn, error, flow, velocity)


def test_a_torn_frame_is_named_with_its_row():
    found = RowPattern(CAMERA).find(residuals(lambda v: np.where(v > 600, -0.02, 0.0)))
    assert 'torn' in found


def test_a_wrong_line_time_is_named():
    found = RowPattern(CAMERA).find(residuals(lambda v: 20e-6 * (v - 511.5)))
    assert 'line_time_us is off by' in found
    assert float(found.split('off by ')[1].split()[0]) == pytest.approx(20, rel=0.2)


@pytest.mark.parametrize('extra', [0.0, 1e-3])
def test_noise_and_a_wrong_focal_length_are_no_pattern(extra):
    pattern = RowPattern(CAMERA)
    assert not any(pattern.find(residuals(np.zeros_like, seed, extra)) for seed in range(200))


def test_stars_of_a_second_image_contradict():
    _, uv, flow = field()
    velocity = flow @ RATE
    torn = np.where(uv[:, 1:] > 511, uv - 0.1 * velocity, uv)
    assert 'second image' in expected_stars(uv, velocity, torn, 0.5)
    ghost = np.where(uv[:, 1:] > 511, uv + [12.0, -7.0], uv)
    assert 'second image' in expected_stars(uv, velocity, ghost, 0.5)


def test_a_second_image_of_very_many_stars_contradicts():
    _, uv, flow = field(count=1000)
    ghost = np.where(uv[:, 1:] > 511, uv + [12.0, -7.0], uv)
    assert 'second image' in expected_stars(uv, flow @ RATE, ghost, 0.5)


def test_hidden_stars_and_false_ones_do_not_contradict():
    rng, uv, flow = field()
    velocity = flow @ RATE
    assert not expected_stars(uv, velocity, uv[uv[:, 1] < 511], 0.5)
    spots = rng.uniform(0, 1024, (300, 2))
    missing = rng.random(len(uv)) < 0.2
    assert not expected_stars(uv, velocity, np.concatenate([uv[~missing], spots]), 0.5)


def test_most_stars_elsewhere_contradict():
    rng, uv, flow = field()
    scattered = rng.uniform(0, 1024, (25, 2))
    found = expected_stars(uv, flow @ RATE, np.concatenate([uv[:12], scattered]), 0.5)
    assert 'should be seen' in found


def test_the_rate_moves_the_stars_of_a_rolling_shutter_to_one_time():
    rng = np.random.default_rng(3)
    q = random_attitude(rng)
    uv = rng.uniform(10, 1013, (30, 2))
    delay_s = 20e-6 * (uv[:, 1] - 511.5)
    icrf = rotate(q, CAMERA.unproject(uv))
    moved = uv + image_jacobian(CAMERA, CAMERA.unproject(uv)) @ RATE * delay_s[:, None]
    count = len(uv)
    seen = Centroids(moved, np.ones(count), np.ones(count), np.full(count, SIGMA_PX),
                     delay_s=delay_s)
    back = at_frame_time(CAMERA, seen, RATE)
    assert np.abs(back.uv - uv).max() < 0.01 and not back.delay_s.any()
    np.testing.assert_allclose(fit_rate(CAMERA, icrf, seen, q), RATE, rtol=0.03, atol=3e-4)
    assert fit_rate(CAMERA, icrf[:5], seen.select(slice(5)), q) is None
    np.testing.assert_allclose(
        CAMERA.project(rotate(conjugate(q), icrf)), uv, atol=1e-9)
