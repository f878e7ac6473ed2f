# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The triangle search against brute force, and how many triangles fit by chance."""

from itertools import permutations
import math

from native_core import kernels
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core import native
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.pairs import build_pairs
from startracker_ros.core.identify.star_matcher import BrightLevel, Rules, StarMatcher
from startracker_ros.core.maths.rotation import random_attitude, rotate

SIGMAS, TOLERANCE = 1.75, 3.5  # of a side, of the stars


class Triangles(StarMatcher):
    """The triangles of a sky of stars (N, 3)."""

    def __init__(self, direction, scale_error):
        count = len(direction)
        sky = OnboardCatalog(np.arange(1, count + 1, dtype=np.int32), direction,
                             np.full(count, 5.0), *np.zeros((2, count), bool))
        pairs = build_pairs(sky, 1e-3, 0.3)
        super().__init__(CAMERA, sky, {'tolerance_sigmas': TOLERANCE}, Rules(scale_error), pairs,
                         pairs.among(0), BrightLevel(0.0, 0, 0))

    def look_up(self, image, sigma, base, most_ns=math.inf):
        """Return the best candidates (M, 3) of an image triangle, and how many fit."""
        best, count = np.empty((5, 3), np.int32), np.zeros(1, np.int32)
        kept, base = self._set_stars(image, sigma), np.array(base, np.int32)
        tested = kernels().stt_triangles(
            self._tracker.handle, self._stars.ctypes.data, base.ctypes.data, most_ns,
            best.ctypes.data, count.ctypes.data)
        del kept
        return best[:count[0]], tested

    def order(self, image, sigma, most=1000):
        """Return the triangles (M, 3) in their order."""
        triangles, kept = np.empty((most, 3), np.int32), self._set_stars(image, sigma)
        count = kernels().stt_triangle_order(
            self._tracker.handle, self._stars.ctypes.data, triangles.ctypes.data, most)
        del kept
        return triangles[:count]


@pytest.fixture(autouse=True)
def library_for_tests(monkeypatch):
    monkeypatch.setattr(native, 'library', kernels)


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
    """One search after the other, with many partners for each star."""
    rng = np.random.default_rng(1)
    direction = patch(rng, 25)
    triangles = Triangles(direction, scale_error)
    some = 0
    for _ in range(25):
        image = rotate(random_attitude(rng), direction[rng.permutation(25)[:3]])
        sigma = rng.uniform(1e-3, 6e-3, 3)
        _, tested = triangles.look_up(image, sigma, np.arange(3))
        assert tested == count_fitting(direction, image, sigma, scale_error)
        some += tested
    assert some > 100


def test_the_best_supported_triangle_is_the_right_one():
    rng = np.random.default_rng(2)
    direction = patch(rng, 60)
    triangles = Triangles(direction, 0.02)
    for _ in range(10):
        shown = rng.permutation(60)[:12]
        image = rotate(random_attitude(rng), direction[shown])
        best, _ = triangles.look_up(image, np.full(12, 2e-5), [4, 0, 7])
        np.testing.assert_array_equal(best[0], shown[[4, 0, 7]])


def test_chance_triangles_are_as_many_as_the_equations_expect():
    rng = np.random.default_rng(3)
    direction = rng.standard_normal((4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    triangles = Triangles(direction, 0.0)
    found = expected = 0.0
    for _ in range(200):
        image, rho = patch(rng, 3), SIGMAS * np.hypot(8e-4, 8e-4)
        area = abs(np.linalg.det(image)) / 2
        if area < 1e-3:
            continue
        found += triangles.look_up(image, np.full(3, 8e-4), np.arange(3))[1]
        ab, ac, bc = (angle(image[i], image[j]) for i, j in ((0, 1), (0, 2), (1, 2)))
        n_ab, n_ac = (4000 ** 2 / 2 * np.sin(theta) * rho for theta in (ab, ac))
        expected += 4 * n_ab * n_ac / 4000 * bc * rho / (2 * np.pi * area)
    assert expected > 1000
    assert found == pytest.approx(expected, rel=0.1)


def test_every_triangle_comes_once_and_a_false_star_is_soon_left():
    rng = np.random.default_rng(4)
    direction = patch(rng, 40)
    image = direction[:12]
    order = Triangles(direction, 0.005).order(image, np.full(12, 1e-4))
    for base in order:
        sides = [angle(image[base[i]], image[base[j]]) for i, j in ((0, 1), (0, 2), (1, 2))]
        assert sides[2] == max(sides)
    assert len({tuple(sorted(each)) for each in order.tolist()}) == len(order) == 220
    assert any(0 not in each for each in order[:4])


@pytest.mark.slow
def test_a_search_ends_within_a_triangle_when_its_work_is_done():
    """Of a triangle that fits everywhere: its lookup alone takes longer than a time limit."""
    rng = np.random.default_rng(4)
    direction = patch(rng, 600)
    triangles = Triangles(direction, 0.05)
    image, sigma = direction[:8], np.full(8, 3e-3)
    ended, whole = (triangles.look_up(image, sigma, np.arange(3), most_ns)[1]
                    for most_ns in (0.0, math.inf))
    assert 10 * ended < whole
