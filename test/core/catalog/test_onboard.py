# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Merging, crowding and search, against plain loops over all pairs."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import (
    build_onboard_catalog, CROWD_MAGNITUDES, CROWD_PX, MERGE_PX, onboard_catalog)
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.maths.rotation import ARCSEC, unit_from_radec

EPOCH_YEAR = 2026.0
MERGE_RAD = 80 * ARCSEC
CROWD_RAD = 240 * ARCSEC


def catalog_of(ra_rad, dec_rad, magnitude) -> StarCatalog:
    """Return fixed stars numbered from 1, brightest first."""
    order = np.argsort(magnitude, kind='stable')
    zeros = np.zeros(len(order))
    return StarCatalog(
        np.arange(1, len(order) + 1, dtype=np.int32), np.asarray(ra_rad, float)[order],
        np.asarray(dec_rad, float)[order], zeros, zeros, zeros,
        np.asarray(magnitude, np.float32)[order], zeros, zeros)


def angle_rad(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def brute_force(catalog: StarCatalog, limit: float) -> dict[int, tuple]:
    """Return hip -> (direction, magnitude, crowded), each pair of stars looked at."""
    direction = catalog.directions(EPOCH_YEAR)
    count = len(catalog)
    image = list(range(count))
    for i in range(count):
        for j in range(i):
            if angle_rad(direction[i], direction[j]) <= MERGE_RAD and image[i] != image[j]:
                old, new = max(image[i], image[j]), min(image[i], image[j])
                image = [new if k == old else k for k in image]
    flux = 10 ** (-0.4 * catalog.magnitude.astype(float))
    total = {k: sum(flux[i] for i in range(count) if image[i] == k) for k in set(image)}
    crowded = set()
    for i in range(count):
        for j in range(count):
            near = angle_rad(direction[i], direction[j]) <= CROWD_RAD
            if image[i] != image[j] and near and total[image[j]] >= (
                    total[image[i]] * 10 ** (-0.4 * CROWD_MAGNITUDES)):
                crowded.add(image[i])
    result = {}
    for k in set(image):
        magnitude = -2.5 * np.log10(total[k])
        if magnitude <= limit + 1e-6:
            center = sum(flux[i] * direction[i] for i in range(count) if image[i] == k)
            result[int(catalog.hip[k])] = (
                center / np.linalg.norm(center), magnitude, k in crowded)
    return result


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2 ** 32 - 1), st.integers(0, 40))
def test_places_agree_with_brute_force(seed, size):
    rng = np.random.default_rng(seed)
    # A patch so small that pairs, chains and crowds are common.
    ra_rad, dec_rad = rng.uniform(0, 0.008, size), rng.uniform(1.2, 1.203, size)
    catalog = catalog_of(ra_rad, dec_rad, rng.uniform(2.0, 9.0, size))
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=7.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    expected = brute_force(catalog, 7.0)
    assert set(onboard.hip.tolist()) == set(expected)
    assert np.all(np.diff(onboard.magnitude) >= 0)
    for k, hip in enumerate(onboard.hip.tolist()):
        direction, magnitude, crowded = expected[hip]
        np.testing.assert_allclose(onboard.direction[k], direction, atol=1e-12)
        assert onboard.magnitude[k] == pytest.approx(magnitude, abs=1e-9)
        assert onboard.crowded[k] == crowded


def test_double_of_faint_stars_belongs_to_the_sky():
    catalog = catalog_of([1.0, 1.0], [0.5, 0.5 + 20 * ARCSEC], [6.5, 6.5])
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=6.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    assert onboard.magnitude == pytest.approx(6.5 - 2.5 * np.log10(2))
    np.testing.assert_allclose(
        onboard.direction[0], unit_from_radec(1.0, 0.5 + 10 * ARCSEC), atol=1e-12)
    assert not onboard.crowded[0] and onboard.blended[0]


@pytest.mark.parametrize('separation, fainter_by, expected', [
    (20, 0.5, True), (20, 3.0, False), (150, 0.5, True), (150, 3.0, False), (400, 0.5, False)])
def test_an_image_may_be_off_an_entry_of_near_stars_alike(separation, fainter_by, expected):
    catalog = catalog_of([1.0, 1.0], [0.5, 0.5 + separation * ARCSEC], [5.0, 5.0 + fainter_by])
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=5.2, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    assert onboard.blended.tolist() == [expected]


def test_chain_becomes_one_image():
    step = 0.9 * MERGE_RAD
    catalog = catalog_of(np.full(5, 2.0), step * np.arange(5), [5.0, 4.0, 5.0, 5.0, 5.0])
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=6.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    assert onboard.hip.tolist() == [1]


def test_faint_neighbour_does_not_crowd_a_bright_star():
    catalog = catalog_of([1.0, 1.0], [0.5, 0.5 + 150 * ARCSEC], [2.0, 5.0])
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=6.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    assert onboard.crowded.tolist() == [False, True]


def test_neighbour_below_the_limit_crowds():
    catalog = catalog_of([1.0, 1.0], [0.5, 0.5 + 150 * ARCSEC], [5.9, 6.8])
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=6.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    assert onboard.crowded.tolist() == [True]


def test_real_sky_of_a_camera():
    camera = Camera.from_fov(1024, 1024, 11.0)
    onboard = onboard_catalog(load_catalog(), camera, EPOCH_YEAR, 7.0)
    # Alpha Centauri A and B are one image, named after A.
    alpha = onboard.index_of(np.array([71683, 71681]))
    assert alpha[0] >= 0 and alpha[1] == -1
    assert onboard.magnitude[alpha[0]] == pytest.approx(-0.28, abs=0.05)
    assert abs(len(onboard) / len(load_catalog().brighter_than(7.0)) - 1) < 0.01
    assert 0.005 < onboard.crowded.mean() < 0.05
    assert np.all(onboard.magnitude.astype(np.float32) <= 7)
    assert MERGE_PX < CROWD_PX


def test_crowded_stars_of_the_real_sky():
    catalog = load_catalog().brighter_than(6.0)
    onboard = build_onboard_catalog(catalog, EPOCH_YEAR, magnitude_limit=6.0, merge_rad=MERGE_RAD,
                                    crowd_rad=CROWD_RAD)
    cosine = onboard.direction @ onboard.direction.T
    np.fill_diagonal(cosine, -1)
    close = np.argwhere(cosine > np.cos(CROWD_RAD))
    assert len(close)
    for a, b in close:
        fainter_by = onboard.magnitude[b] - onboard.magnitude[a]
        if fainter_by <= CROWD_MAGNITUDES - 0.01 and cosine[a, b] > np.cos(0.9 * CROWD_RAD):
            assert onboard.crowded[a]


def test_within_agrees_with_brute_force():
    onboard = onboard_stars(SMALL_CAMERA, EPOCH_YEAR, 5.0)
    rng = np.random.default_rng(3)
    for radius_rad in (0.0, 0.01, 0.3, 2.0, np.pi):
        center = rng.normal(size=3)
        center /= np.linalg.norm(center)
        found = onboard.within(center, radius_rad)
        distance = np.linalg.norm(onboard.direction - center, axis=1)
        np.testing.assert_array_equal(
            found, np.flatnonzero(distance <= 2 * np.sin(radius_rad / 2)))


def test_index_of():
    onboard = onboard_stars(SMALL_CAMERA, EPOCH_YEAR, 5.0)
    np.testing.assert_array_equal(onboard.index_of(onboard.hip), np.arange(len(onboard)))
    assert onboard.index_of(np.array([0, -5, 999999])).tolist() == [-1, -1, -1]
    assert onboard.index_of(np.zeros(0, np.int32)).shape == (0,)


def test_empty_sky():
    onboard = build_onboard_catalog(catalog_of([], [], []), EPOCH_YEAR, magnitude_limit=6.0,
                                    merge_rad=MERGE_RAD, crowd_rad=CROWD_RAD)
    assert len(onboard) == 0
    assert len(onboard.within(np.array([0.0, 0.0, 1.0]), 1.0)) == 0
    assert onboard.index_of(np.array([5])).tolist() == [-1]
