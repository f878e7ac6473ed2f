# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fields of view that nobody knows are found by quads, and noise has none."""

import numpy as np
import pytest
from startracker_evaluation.campaign.fisheyes import draw_night
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog, load_deep_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.folders import cache_folder
from startracker_ros.core.maths.rotation import (
    attitude_error, matrix_from_quaternion, quaternion_from_pointing, random_attitude)
from startracker_ros.photographs import blind
from startracker_ros.photographs.blind import BlindIdentifier, LENS_ERROR
from startracker_ros.photographs.estimated_lens import estimate_lens
from startracker_ros.photographs.photograph import PhotographSolver

WIDTH, HEIGHT, EPOCH_YEAR = 1392, 1040, 2030.0
SHAPE = HEIGHT, WIDTH
NOISE_PX = 0.3


def centroids(uv, flux):
    order = np.argsort(-flux)
    count = len(uv)
    return Centroids(uv[order], flux[order], np.full(count, 50.0), np.full(count, NOISE_PX))


def frame(rng, fov_deg, stars, spots):
    """Return the brightest stars of a random field among false spots, and the attitude."""
    camera, q = Camera.from_fov(WIDTH, HEIGHT, fov_deg), random_attitude(rng)
    catalog = camera_catalog(camera)
    direction, matrix = catalog.directions(EPOCH_YEAR), matrix_from_quaternion(q)
    seen = np.flatnonzero(direction @ matrix[:, 2] > np.cos(camera.corner_angle_rad))
    uv = camera.project(direction[seen] @ matrix)
    seen, uv = seen[camera.contains(uv)][:stars], uv[camera.contains(uv)][:stars]
    magnitude = catalog.magnitude[seen] + rng.normal(0, 0.3, len(seen))
    uv = np.vstack([uv + rng.normal(0, NOISE_PX, uv.shape),
                    rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (spots, 2))])
    flux = 10 ** (-0.4 * magnitude)
    return centroids(uv, np.concatenate([flux, rng.choice(flux, spots)])), q


@pytest.fixture(scope='module')
def identifier():
    return BlindIdentifier(EPOCH_YEAR)


@pytest.mark.parametrize('fov_deg', [
    6.0, 14.0, 35.0, 100.0, *(pytest.param(fov_deg, marks=pytest.mark.long)
                              for fov_deg in (9.0, 22.0, 60.0))])
def test_a_field_of_any_width_is_found(identifier, fov_deg):
    rng, solved = np.random.default_rng(int(fov_deg)), 0
    for _ in range(5):
        stars, q = frame(rng, fov_deg, 15, 15)
        for attempt in identifier.identify([stars], SHAPE):
            lens = estimate_lens(attempt, LENS_ERROR)
            if not lens.rejected:
                off_rad = np.linalg.norm(attitude_error(lens.attitude.quaternion, q))
                assert off_rad < 0.01 * np.radians(fov_deg)
                assert np.degrees(lens.camera.fov_x_rad) == pytest.approx(fov_deg, rel=0.02)
                solved += 1
                break
    # Of a hundred simulated fields of each width at least 90 are found.
    assert solved >= 3


@pytest.mark.slow
@pytest.mark.parametrize('fov_deg', [1.3, 2.2])
def test_a_narrow_field_anywhere_on_the_sky_is_found(identifier, fov_deg):
    rng, solved = np.random.default_rng(4), 0
    for _ in range(10):
        stars, q = frame(rng, fov_deg, 16, 4)
        for attempt in identifier.identify([stars], SHAPE):
            lens = estimate_lens(attempt, LENS_ERROR)
            if not lens.rejected:
                error = attitude_error(lens.attitude.quaternion, q)
                # A roll is measured over the narrow field alone.
                assert np.hypot(*error[:2]) < 0.01 * np.radians(fov_deg)
                assert abs(error[2]) < 0.003
                solved += 1
                break
    assert solved >= 8


def test_a_narrow_field_far_from_the_milky_way_is_found_behind_haze(identifier):
    """The stars of one side have a tenth of their light: most that are seen are faint."""
    rng, camera, catalog = np.random.default_rng(5), Camera.from_fov(
        WIDTH, HEIGHT, 3.3), load_deep_catalog()
    direction, solved = catalog.directions(EPOCH_YEAR), 0
    for _ in range(10):
        # Some 60 deg from the galactic equator.
        q = quaternion_from_pointing(*np.radians(rng.uniform([185, 20, 0], [215, 50, 360])))
        sensor = direction @ matrix_from_quaternion(q)
        uv = camera.project(sensor)
        seen = camera.contains(uv) & (sensor[:, 2] > 0)
        flux = 10 ** (-0.4 * catalog.magnitude[seen] - 1.0 * (1 - uv[seen, 0] / WIDTH))
        stars = centroids(uv[seen] + rng.normal(0, NOISE_PX, (seen.sum(), 2)), flux)
        for attempt in identifier.identify([stars.select(np.arange(40))], SHAPE):
            lens = estimate_lens(attempt, LENS_ERROR)
            if not lens.rejected:
                assert np.hypot(*attitude_error(lens.attitude.quaternion, q)[:2]) < 1e-4
                solved += 1
                break
    assert solved >= 9


@pytest.mark.parametrize('ra_deg, dec_deg', [(130.1, 19.67), (34.9, 57.1), (83.8, -5.4)])
def test_a_cluster_is_found_in_a_field_below_a_degree(identifier, ra_deg, dec_deg):
    """Praesepe, the double cluster in Perseus, and the sword of Orion."""
    camera, catalog = Camera.from_fov(WIDTH, HEIGHT, 0.85), load_deep_catalog()
    q = quaternion_from_pointing(*np.radians([ra_deg, dec_deg, 20.0]))
    sensor = catalog.directions(EPOCH_YEAR) @ matrix_from_quaternion(q)
    uv = camera.project(sensor)
    seen = camera.contains(uv) & (sensor[:, 2] > 0)
    stars = centroids(uv[seen], 10 ** (-0.4 * catalog.magnitude[seen]))
    lens = estimate_lens(next(identifier.identify([stars], SHAPE)), LENS_ERROR)
    assert not lens.rejected
    assert np.hypot(*attitude_error(lens.attitude.quaternion, q)[:2]) < 1e-4


@pytest.mark.parametrize('spots', [4, 12, 60])
@pytest.mark.parametrize('seed', range(3))
def test_random_spots_are_not_a_field(identifier, spots, seed):
    rng = np.random.default_rng(seed)
    noise = centroids(rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (spots, 2)),
                      10 ** rng.uniform(2, 4, spots))
    assert not [*identifier.identify([noise], SHAPE)]


def test_a_mirrored_field_is_found_only_mirrored(identifier):
    stars, _ = frame(np.random.default_rng(3), 14.0, 20, 0)
    flipped = centroids([WIDTH - 1, 0] + stars.uv * [-1, 1], stars.flux)
    assert not [*identifier.identify([flipped], SHAPE)]
    assert next(identifier.identify_quickly([stars], SHAPE), None) is not None


def test_a_list_without_stars_takes_those_of_another(identifier):
    """Each identification is of the stars of all lists, the first being too poor for a quad."""
    stars, _ = frame(np.random.default_rng(3), 14.0, 20, 0)
    few = stars.select(np.arange(len(stars)) < 3)
    first, second = list(identifier.identify([few, stars], SHAPE))[:2]
    assert first.centroids is stars and second.centroids is few
    np.testing.assert_array_equal(second.identification.hip, first.identification.hip[:3])
    assert second.identification.hip.any()


@pytest.mark.long
def test_all_epochs_share_one_set_of_databases(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    stars, _ = frame(np.random.default_rng(3), 14.0, 20, 0)
    assert next(BlindIdentifier(2026.0).identify([stars], SHAPE), None) is not None
    files = {file.name for file in cache_folder().iterdir()}
    later = next(BlindIdentifier(1995.0).identify([stars], SHAPE))
    assert {file.name for file in cache_folder().iterdir()} == files
    # The fastest star of the field.
    catalog = camera_catalog(Camera.from_fov(WIDTH, HEIGHT, 14.0))
    found = later.identification.hip
    row = max(np.flatnonzero(np.isin(catalog.hip, found[found > 0])),
              key=lambda row: np.hypot(catalog.pm_ra_mas_yr[row], catalog.pm_dec_mas_yr[row]))
    star, = later.onboard.index_of(catalog.hip[[row]])
    off_rad = np.linalg.norm(later.onboard.direction[star] - catalog.directions(1995.0)[row])
    moved_rad = np.linalg.norm(catalog.directions(2015.0)[row] - catalog.directions(1995.0)[row])
    assert off_rad < 0.25 * moved_rad


def test_an_ordinary_field_needs_no_deep_quads(monkeypatch):
    read, table = [], BlindIdentifier._table
    monkeypatch.setattr(BlindIdentifier, '_table',
                        lambda self, number: read.append(number) or table(self, number))
    stars, _ = frame(np.random.default_rng(14), 14.0, 15, 3)
    assert next(BlindIdentifier(EPOCH_YEAR).identify([stars], SHAPE), None) is not None
    assert set(read) == {0}


def test_a_fisheye_is_found_before_all_stars_are_searched(monkeypatch):
    last_stars, search = [], BlindIdentifier._candidates
    monkeypatch.setattr(BlindIdentifier, '_candidates', lambda self, lists, seen, *which: (
        last_stars.append(which[-1]) or search(self, lists, seen, *which)))
    night = draw_night(np.random.default_rng(len('equidistant')), 'equidistant')
    assert PhotographSolver(2026.0).solve_lists([night.centroids], night.shape).solved
    assert max(last_stars) <= blind.QUICK_BATCHES[-1]
