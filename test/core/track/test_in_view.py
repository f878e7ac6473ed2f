# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars around an attitude are those of the catalogue's own search, wherever it turns."""

from dataclasses import replace

import native_bank
import numpy as np
import pytest
from skies import onboard_stars
from startracker_ros.core.astro.observer_motion import observer_at
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.model import Camera, project
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_pointing, rotate
from startracker_ros.core.track.in_view import BRIGHT_STARS, StarsInView

PLAIN = Camera.from_fov(512, 512, 20.0)
DISTORTED = replace(PLAIN, distortion=(-0.1, 0.02, 1e-3, -5e-4, 0.0))
FISHEYE = Camera(512, 512, 200.0, 200.0, 250.0, 260.0, (-0.02, 0.004, 0.0, 0.0), 'equidistant')


@pytest.mark.parametrize('camera', [PLAIN, DISTORTED, FISHEYE])
def test_as_the_catalogue_and_the_camera_say(camera):
    onboard = onboard_stars(camera, 2026.0, 6.0)
    file = native_bank.sky_file(camera, onboard.direction, magnitude=onboard.magnitude)
    view = native_bank.View(native_bank.sky_struct(file), camera)
    # Small steps, which keep the stars of the search before, and leaps.
    for ra_deg in (10.0, 10.1, 10.4, 10.9, 200.0, 10.0):
        q = quaternion_from_pointing(*np.radians([ra_deg, 40.0, 3 * ra_deg]))
        index, sensor, uv = view.in_view(q)
        expected = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
        assert len(index) > 20
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_allclose(sensor, rotate(conjugate(q), onboard.direction[index]),
                                   atol=1e-14)
        np.testing.assert_allclose(uv, camera.project(sensor), atol=1e-9)


@pytest.mark.parametrize('camera', [PLAIN, DISTORTED, FISHEYE])
def test_spots_are_compared_with_the_faintest_stars_too(camera):
    onboard = onboard_stars(camera, 2026.0, 9.0)
    sky = ApparentCatalog(onboard, observer_at(2026.0, np.array([3e3, 5e3, -4e3])))
    stars, rng = StarsInView(camera, onboard), np.random.default_rng(3)
    q = quaternion_from_pointing(*np.radians([80.0, 20.0, 30.0]))
    attitude = AttitudeEstimate(q, np.eye(3) * 1e-12, 9, np.zeros(9), 9.0)
    index = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    uv = camera.project(rotate(conjugate(q), sky.direction(index)))
    assert np.count_nonzero(camera.contains(uv)) > 10 * BRIGHT_STARS
    spots = rng.uniform(5, 500, (200, 2))
    sigma = rng.uniform(0.01, 1.0, 200)
    spots[:2], sigma[2:4] = np.nan, (0.0, np.nan)
    reach = np.maximum(2.0, 5 * sigma)
    distance = np.linalg.norm(spots[:, None] - uv, axis=2).min(axis=1)
    expected = np.flatnonzero((distance > reach) & (sigma > 0))
    assert 20 < len(expected) < 190
    np.testing.assert_array_equal(
        stars.unexplained(sky, attitude, spots, sigma, 2.0, 5.0), expected)


@pytest.mark.parametrize('camera', [PLAIN, DISTORTED])
def test_projects_as_the_camera(camera):
    directions = np.random.default_rng(1).normal(0, 1, (100, 3))
    directions[:, 2] = np.where(np.arange(100) % 10, 5 + directions[:, 2], directions[:, 2])
    np.testing.assert_allclose(project(camera.native, directions), camera.project(directions),
                               rtol=1e-12, atol=1e-9)
