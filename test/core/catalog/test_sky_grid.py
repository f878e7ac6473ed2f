# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled neighbour searches against all distances."""

import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, count_in_image, count_near, nearest, sky_grid, stars_near)
from startracker_ros.core.maths.rotation import matrix_from_quaternion, random_attitude


@pytest.fixture(scope='module')
def directions():
    return onboard_stars(CAMERA, 2026.0, 6.0).direction


@pytest.mark.parametrize('chord', [1e-4, 0.003, 0.02, 0.5, 2.1])
def test_the_nearest_star_is_found(directions, chord):
    grid = sky_grid(directions)
    rng = np.random.default_rng(1)
    asked = rng.standard_normal((200, 3))
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    # At the axes the vectors lie on the border of the cube.
    asked = np.concatenate([asked, np.eye(3), -np.eye(3), directions[:50]])
    for vector in asked:
        star, square = nearest(grid, *vector, chord)
        distance = np.linalg.norm(directions - vector, axis=1)
        if distance.min() <= chord:
            assert star == distance.argmin()
            assert np.sqrt(square) == pytest.approx(distance.min(), abs=1e-12)
        else:
            assert star == -1


@pytest.mark.parametrize('chord', [0.0, 0.003, 0.5, 1.9])
def test_stars_near_are_counted(directions, chord):
    centers = np.concatenate([directions[:20], -directions[:20], np.eye(3)])
    distance = np.linalg.norm(directions - centers[:, None], axis=2)
    grid = sky_grid(directions)
    np.testing.assert_array_equal(
        count_near(grid, centers, chord), (distance <= chord).sum(axis=1))
    for center, apart in zip(centers, distance):
        np.testing.assert_array_equal(np.sort(stars_near(grid, center, chord)),
                                      np.flatnonzero(apart <= chord))


def test_stars_in_an_image_are_counted(directions):
    grid = sky_grid(directions)
    rng = np.random.default_rng(2)
    border = np.tan(np.radians(6.0))
    for _ in range(100):
        matrix = matrix_from_quaternion(random_attitude(rng))
        seen = CAMERA.contains(CAMERA.project(directions @ matrix))
        for brightest in (len(directions), 1000):
            count = count_in_image(grid, False, matrix, 0.2, -border, border, -border, border,
                                   brightest)
            assert count == seen[:brightest].sum()


def test_stars_in_a_fisheye_are_counted(directions):
    camera = Camera.from_fov(600, 500, 150.0, 'equidistant')
    grid, matrix = sky_grid(directions), matrix_from_quaternion([0.1, 0.3, -0.2, 0.9])
    half = 500 / 600 * np.radians(75)
    count = count_in_image(grid, True, matrix, 2.0, -np.radians(75), np.radians(75), -half, half,
                           len(directions))
    assert count == camera.contains(camera.project(directions @ matrix)).sum() > 100


def test_an_empty_sky_has_no_nearest_star():
    assert nearest(sky_grid(np.empty((0, 3))), 0.0, 0.0, 1.0, 1.0)[0] == -1


@pytest.mark.parametrize('count', [1, 3, 500])
def test_the_brightest_of_each_part_of_the_sky_are_few_and_everywhere(count):
    direction, asked = (np.random.default_rng(seed).standard_normal((size, 3))
                        for seed, size in ((5, count), (6, 300)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    chosen = brightest_everywhere(direction, 3 / np.radians(30.0) ** 2)
    assert (np.diff(chosen) > 0).all() and chosen[0] == 0
    if count == 500:
        # Of some 50 cells of 30 deg three each; no direction is far from all of them.
        assert 100 < len(chosen) < 200
        asked /= np.linalg.norm(asked, axis=1, keepdims=True)
        nearest_star = (asked @ direction[chosen].T).max(axis=1)
        assert np.degrees(np.arccos(nearest_star.min())) < 40
