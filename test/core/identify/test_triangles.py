# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The triangle search against brute force, and how many triangles fit by chance."""

from itertools import permutations

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.clock import search_clock
from startracker_ros.core.identify.pair_search import expected_pairs, image_side, pair_level
from startracker_ros.core.identify.pairs import build_pairs
from startracker_ros.core.identify.triangle_order import new_state, next_triangle
from startracker_ros.core.identify.triangles import catalogue_triangles, image_triangle
from startracker_ros.core.identify.verification import Verifier
from startracker_ros.core.maths.rotation import random_attitude, rotate

SIGMAS = 3.5
NO_LIMIT = search_clock(np.inf, np.inf, np.full(1, np.inf))


def make(direction, scale_error):
    """Return level and verifier of a sky of stars (N, 3)."""
    count = len(direction)
    sky = OnboardCatalog(np.arange(1, count + 1, dtype=np.int32), direction, np.full(count, 5.0),
                         *np.zeros((2, count), bool))
    level = pair_level(build_pairs(sky, 1e-3, 0.3), 40, 1000)
    return level, Verifier(CAMERA, sky, SIGMAS, scale_error).data


def patch(rng, count):
    direction = np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), np.ones(count)])
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def angle(a, b):
    return 2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2)


def count_fitting(direction, image, sigma, scale_error):
    """Return how many ordered triples fit, by the equations of the module."""
    theta, gate = np.array([
        (angle(image[i], image[j]), SIGMAS * np.hypot(sigma[i], sigma[j]))
        for i, j in ((0, 1), (0, 2), (1, 2))]).T
    volume = np.linalg.det(image)
    flat = abs(volume) < 4 * gate.max() / SIGMAS * theta.max()
    triples = direction[list(permutations(range(len(direction)), 3))]
    a, b, c = np.moveaxis(triples, 1, 0)
    d = np.stack([angle(a, b), angle(a, c), angle(b, c)], -1)
    s = np.sum(theta * d / gate ** 2, -1, keepdims=True) / np.sum(theta ** 2 / gate ** 2)
    fits = (abs(d - s * theta) <= gate) & (abs(d - theta) <= gate + scale_error * theta)
    return np.sum(fits.all(1) & (flat | (np.linalg.det(triples) * volume > 0)))


@pytest.mark.parametrize('scale_error', [pytest.param(0.0, marks=pytest.mark.long), 0.005])
def test_the_search_finds_what_trying_all_stars_finds(scale_error):
    """One search after the other in the same work arrays, with many partners for each star."""
    rng = np.random.default_rng(1)
    direction = patch(rng, 25)
    level, verifier = make(direction, scale_error)
    some = 0
    for _ in range(25):
        image = rotate(random_attitude(rng), direction[rng.permutation(25)[:3]])
        sigma = rng.uniform(5e-4, 3e-3, 3)
        tested = np.zeros(1, np.int64)
        catalogue_triangles(level, verifier, image, sigma, np.arange(3), tested, NO_LIMIT)
        assert tested[0] == count_fitting(direction, image, sigma, scale_error)
        some += tested[0]
    assert some > 100


def test_the_best_supported_triangle_is_the_right_one():
    rng = np.random.default_rng(2)
    direction = patch(rng, 60)
    level, verifier = make(direction, 0.02)
    for _ in range(10):
        shown = rng.permutation(60)[:12]
        image = rotate(random_attitude(rng), direction[shown])
        best, count = catalogue_triangles(level, verifier, image, np.full(12, 2e-5),
                                          np.array([4, 0, 7]), np.zeros(1, np.int64), NO_LIMIT)
        assert count >= 1
        np.testing.assert_array_equal(best[0], shown[[4, 0, 7]])


def test_chance_triangles_are_as_many_as_the_equations_expect():
    rng = np.random.default_rng(3)
    direction = rng.standard_normal((4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    level, verifier = make(direction, 0.0)
    found = expected = 0.0
    for _ in range(200):
        image, sigma = patch(rng, 3), np.full(3, 4e-4)
        triangle = image_triangle(image, sigma, np.arange(3), SIGMAS)
        area = abs(np.linalg.det(image)) / 2
        if area < 1e-3:
            continue
        tested = np.zeros(1, np.int64)
        catalogue_triangles(level, verifier, image, sigma, np.arange(3), tested, NO_LIMIT)
        n_ab, n_ac = (expected_pairs(level.table.values, 4000, side, 0.0)
                      for side in (triangle.ab, triangle.ac))
        found += tested[0]
        expected += (4 * n_ab * n_ac / 4000
                     * triangle.bc.theta * triangle.bc.rho / (2 * np.pi * area))
    assert expected > 1000
    assert found == pytest.approx(expected, rel=0.1)


def test_every_triangle_comes_once_and_a_false_star_is_soon_left():
    rng = np.random.default_rng(4)
    direction = patch(rng, 40)
    level, _ = make(direction, 0.005)
    image, sigma = direction[:12], np.full(12, 1e-4)
    state, base = new_state(12, 40), np.empty(3, np.int64)
    order = []
    while next_triangle(level, SIGMAS, 0.005, image, sigma, state, base) > 0:
        order.append(tuple(base))
        sides = [image_side(image, sigma, SIGMAS, base[i], base[j]).theta
                 for i, j in ((0, 1), (0, 2), (1, 2))]
        assert sides[2] == max(sides)
    assert len({tuple(sorted(each)) for each in order}) == len(order) == 220
    assert any(0 not in each for each in order[:4])


@pytest.mark.slow
def test_a_search_ends_within_a_triangle_when_time_is_up():
    """Of a triangle that fits everywhere: its lookup alone takes longer than a time limit."""
    rng = np.random.default_rng(4)
    direction = patch(rng, 600)
    level, verifier = make(direction, 0.05)
    image, sigma = direction[:8], np.full(8, 3e-3)
    tested = []
    for deadline_s, until_s in ((0.0, np.inf), (np.inf, 0.0), (np.inf, np.inf)):
        count = np.zeros(1, np.int64)
        catalogue_triangles(level, verifier, image, sigma, np.arange(3), count,
                            search_clock(deadline_s, np.inf, np.full(1, until_s)))
        tested.append(count[0])
    assert 10 * max(tested[:2]) < tested[2]
