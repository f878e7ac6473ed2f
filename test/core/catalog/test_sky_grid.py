# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches of neighbours against all distances."""

import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, pairs_within, sky_angles, sky_grid, sorted_by_cell, stars_near)
from startracker_ros.core.native import NativeError


@pytest.fixture(scope='module')
def directions():
    return onboard_stars(CAMERA, 2026.0, 6.0).direction


@pytest.mark.parametrize('chord', [1e-4, 0.003, 0.2, 2.1])
def test_pairs_are_all_of_those_within_a_chord(directions, chord):
    few = directions[:400]
    pairs, square = pairs_within(sky_grid(few), chord)
    distance = np.linalg.norm(few[:, None] - few, axis=2)
    expected = np.argwhere(np.triu(distance <= chord, 1))
    order = np.lexsort(pairs.T[::-1])
    np.testing.assert_array_equal(pairs[order], expected)
    np.testing.assert_allclose(np.sqrt(square), distance[tuple(pairs.T)], atol=1e-12)


@pytest.mark.parametrize('chord', [0.0, 0.003, 0.5, 1.9])
def test_stars_near_are_found(directions, chord):
    centers = np.concatenate([directions[:20], -directions[:20], np.eye(3)])
    distance = np.linalg.norm(directions - centers[:, None], axis=2)
    grid = sky_grid(directions)
    for center, apart in zip(centers, distance):
        np.testing.assert_array_equal(np.sort(stars_near(grid, center, chord)),
                                      np.flatnonzero(apart <= chord))


@pytest.mark.parametrize('count', [1, 3, 500])
def test_the_brightest_of_each_part_of_the_sky_are_few_and_everywhere(count):
    direction, asked = (np.random.default_rng(seed).standard_normal((size, 3))
                        for seed, size in ((5, count), (6, 300)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    chosen = np.flatnonzero(
        brightest_everywhere(sky_angles(direction), 3 / np.radians(30.0) ** 2))
    assert chosen[0] == 0
    if count == 500:
        # Of some 50 cells of 30 deg three each; no direction is far from all of them.
        assert 100 < len(chosen) < 200
        asked /= np.linalg.norm(asked, axis=1, keepdims=True)
        nearest_star = (asked @ direction[chosen].T).max(axis=1)
        assert np.degrees(np.arccos(nearest_star.min())) < 40


def test_things_are_sorted_by_cell_as_by_any_stable_sort():
    rng = np.random.default_rng(0)
    for cells in (1, 1000, 1_827_904):
        cell = rng.integers(0, cells, 20_000)
        start, order = sorted_by_cell(cell, cells)
        np.testing.assert_array_equal(order, np.argsort(cell, kind='stable'))
        np.testing.assert_array_equal(np.diff(start), np.bincount(cell, minlength=cells))
    assert not len(sorted_by_cell(np.zeros(0, int), 5)[1])
    with pytest.raises(NativeError):
        sorted_by_cell(np.array([0, 5]), 5)
