# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quads: the search against brute force, the field match, and bad images of the real sky."""

from dataclasses import replace
from functools import partial
from itertools import combinations, count, islice, permutations
from types import SimpleNamespace

import numpy as np
import pytest
import skies
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify import identification
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.pairs import build_pairs
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, multiply, random_attitude, rotate)
from startracker_ros.core.papers.quad import base_quads, full_field_match, matching_quads

CAMERA = Camera.from_fov(1024, 1024, 20.3)
EPOCH_YEAR = 2026.5
SIDES = list(combinations(range(4), 2))


@pytest.fixture(scope='module')
def identifier():
    return make_identifier(CAMERA, EPOCH_YEAR,
                           IdentificationOptions(method='quad', magnitude_limit=5.5))


@pytest.fixture(scope='module')
def hasty(identifier):
    """One that gives up soon."""
    return make_identifier(CAMERA, EPOCH_YEAR, replace(identifier.options, time_limit_s=0.03))


frame = partial(skies.frame, sigma_px=0.5)


def off_by_deg(result, q):
    """Return the angle between the attitudes."""
    return np.degrees(np.linalg.norm(attitude_error(result.attitude.quaternion, q)))


def angle(a, b):
    return 2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2)


def sky(direction):
    """Return an on-board catalogue with stars at directions (N, 3)."""
    count = len(direction)
    return OnboardCatalog(np.arange(1, count + 1, dtype=np.int32), direction, np.full(count, 5.0),
                          *np.zeros((2, count), bool))


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(8))
def test_the_search_finds_what_trying_all_stars_finds(seed):
    """A small patch with wide tolerances, so that stars have several partners on each side."""
    rng = np.random.default_rng(seed)
    direction = np.column_stack([rng.uniform(-0.1, 0.1, (14, 2)), np.ones(14)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    pairs = build_pairs(sky(direction), 1e-3, 1.0)
    image = rotate(random_attitude(rng), direction[rng.permutation(14)[:4]])
    sigma_rad, sigmas, scale = np.full(4, 0.006), 3.5, 0.01
    triple = max(combinations(range(4), 3), key=lambda t: abs(np.linalg.det(image[list(t)])))
    hand = np.sign(np.linalg.det(image[list(triple)]))

    def fits(stars):
        place = direction[list(stars)]
        for i, j in SIDES:
            seen = angle(image[i], image[j])
            reach = sigmas * 0.006 * np.sqrt(2) + scale * seen
            if abs(angle(place[i], place[j]) - seen) > reach:
                return False
        return np.sign(np.linalg.det(place[list(triple)])) == hand

    expected = sorted(stars for stars in permutations(range(14), 4) if fits(stars))
    found = matching_quads(pairs, direction, image, sigma_rad, sigmas, scale)
    assert len(expected) > 1
    assert sorted(map(tuple, found)) == expected


def test_mirrored_quads_do_not_fit():
    rng = np.random.default_rng(1)
    direction = np.column_stack([rng.uniform(-0.1, 0.1, (30, 2)), np.ones(30)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    pairs = build_pairs(sky(direction), 1e-3, 1.0)
    for _ in range(20):
        star = rng.permutation(30)[:4]
        search = (np.full(4, 1e-5), 3.5, 1e-4)
        found = matching_quads(pairs, direction, direction[star], *search)
        np.testing.assert_array_equal(found, [star])
        assert not len(matching_quads(pairs, direction, direction[star] * [-1, 1, 1], *search))


def test_quads_that_fit_everywhere_are_passed_over(hasty):
    """Errors as large as the field would ask for every pair of the sky."""
    rng = np.random.default_rng(2)
    centroids, _ = star_list(hasty.onboard, CAMERA, random_attitude(rng), 0.5, rng)
    result = hasty.identify(replace(centroids, sigma_px=np.full(len(centroids), 1e3)))
    assert result.attitude is None


def test_base_quads_begin_with_the_brightest_and_leave_none_out():
    quads = [tuple(quad) for quad in base_quads(8)]
    assert quads[0] == (0, 1, 2, 3)
    assert sorted(quads) == list(combinations(range(8), 4))
    assert list(base_quads(3)) == []


def test_a_false_star_is_soon_left_aside():
    """However many of the brightest are false, four true stars come in a few tries."""
    for false in range(1, 7):
        tries = next(i for i, quad in enumerate(base_quads(20)) if quad.min() >= false)
        assert tries < 40


def test_the_field_match_names_each_star_and_no_false_one(identifier):
    rng = np.random.default_rng(3)
    onboard = identifier.onboard
    named = stars = misnamed = 0
    for _ in range(20):
        centroids, hip = star_list(onboard, CAMERA, random_attitude(rng), 0.5, rng, false=5)
        field = identifier.field_stars(centroids)
        true = hip[field.index]
        base = np.flatnonzero(true)[:4]
        found = full_field_match(onboard, 1.05 * CAMERA.corner_angle_rad, 3.5, 0.005,
                                 field.direction, field.sigma_rad, base,
                                 onboard.index_of(true[base]))
        known = found >= 0
        assert len(np.unique(found[known])) == np.count_nonzero(known)
        stars += np.count_nonzero(true)
        named += np.count_nonzero(onboard.hip[found[known]] == true[known])
        misnamed += np.count_nonzero(onboard.hip[found[known]] != true[known])
    assert named >= 0.98 * stars
    assert misnamed <= 2


def test_a_wrong_quad_is_not_confirmed(identifier):
    """The stars of another part of the sky under the same quad agree with nothing."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        centroids, hip = star_list(identifier.onboard, CAMERA, random_attitude(rng), 0.5, rng)
        field = identifier.field_stars(centroids)
        stars = identifier.onboard.index_of(hip[field.index[:4]])
        right = identifier.verifier.supported(field.direction, field.sigma_rad, np.arange(4),
                                              np.stack([stars[[1, 0, 3, 2]], stars]))
        assert list(right) == [1]


@pytest.mark.parametrize('false, missing', [(0, 0.0), (5, 0.0), (5, 0.2)])
def test_random_attitudes(identifier, false, missing):
    rng = np.random.default_rng(false)
    solved, count = 0, 40
    for _ in range(count):
        q = random_attitude(rng)
        centroids, hip = star_list(identifier.onboard, CAMERA, q, 0.5, rng, false=false,
                                   missing=missing)
        result = identifier.identify(centroids)
        if result.attitude is None:
            assert result.reason and not result.hip.any()
            continue
        solved += 1
        assert off_by_deg(result, q) < 0.1
        assert result.false_alarm_probability <= 1e-5
        known = result.hip > 0
        assert np.count_nonzero(result.hip[known] != hip[known]) <= 1
    assert solved >= 0.95 * count


@pytest.mark.slow
@pytest.mark.parametrize('count', [25, pytest.param(100, marks=pytest.mark.long)])
def test_false_stars_alone_are_never_accepted(hasty, count):
    rng = np.random.default_rng(5)
    for _ in range(count):
        result = hasty.identify(frame(rng.uniform(0, 1023, (20, 2))))
        assert result.attitude is None
        assert result.status in ('no_candidate', 'time_limit')


def test_mirrored_fields_are_never_accepted(hasty):
    rng = np.random.default_rng(6)
    for _ in range(20):
        centroids, _ = star_list(hasty.onboard, CAMERA, random_attitude(rng), 0.5, rng)
        mirrored = replace(centroids, uv=centroids.uv * [-1, 1] + [1023, 0])
        assert hasty.identify(mirrored).attitude is None


@pytest.mark.parametrize('count', [0, 1, 4])
def test_too_few_stars(identifier, count):
    rng = np.random.default_rng(7)
    centroids, _ = star_list(identifier.onboard, CAMERA, random_attitude(rng), 0.5, rng)
    result = identifier.identify(frame(centroids.uv[:count], centroids.flux[:count]))
    assert result.status == 'too_few_stars'
    assert f'{count} usable stars, quad needs 5' in result.reason
    assert len(result.hip) == count


def test_useless_rows_are_left_out(identifier):
    """NaN, outside the image, found twice, without an error: the rest gives the right result."""
    rng = np.random.default_rng(8)
    for _ in range(5):
        q = random_attitude(rng)
        centroids, _ = star_list(identifier.onboard, CAMERA, q, 0.5, rng)
        bad = [[np.nan, 5.0], [np.inf, 1.0], [-50.0, 10.0], [1e6, 1e6], *(centroids.uv[:3] + 0.4),
               [500.0, 500.0]]
        uv = np.concatenate([bad, centroids.uv])
        flux = np.concatenate([np.full(8, 1e9), centroids.flux])
        sigma_px = np.concatenate([np.full(7, 0.5), [np.nan], centroids.sigma_px])
        result = identifier.identify(replace(frame(uv, flux), sigma_px=sigma_px))
        assert result.status == 'identified'
        assert not result.hip[[0, 1, 2, 3, 7]].any()
        assert off_by_deg(result, q) < 0.1


@pytest.mark.parametrize('uv', [
    np.full((50, 2), 300.0), np.full((50, 2), np.nan),
    np.column_stack([np.linspace(10, 1000, 20), np.full(20, 400.0)])],
    ids=['one place', 'nan', 'a line'])
def test_degenerate_fields_are_never_accepted(hasty, uv):
    assert hasty.identify(frame(uv)).attitude is None


def test_thousands_of_centroids_are_bounded_work(identifier, monkeypatch):
    """With a clock that advances by one second per reading: it is read once for each base."""
    rng = np.random.default_rng(9)
    centroids = frame(rng.uniform(0, 1023, (5000, 2)))
    limited = make_identifier(CAMERA, EPOCH_YEAR, replace(identifier.options, time_limit_s=20.0))
    monkeypatch.setattr(identification, 'time', SimpleNamespace(
        thread_time=count().__next__, monotonic=lambda: 0.0))
    result = limited.identify(centroids)
    field = limited.field_stars(centroids)
    tested = [len(found.stars) for found in islice(limited.candidates(field), 21)]
    assert len(field) == limited.options.max_image_stars and max(tested) <= 20
    assert result.status == 'time_limit'
    assert result.reason == (
        f'not identified within time_limit_s = 20, {sum(tested)} candidates tested')


def test_a_catalogue_without_quads_gives_no_result(identifier):
    rng = np.random.default_rng(10)
    centroids, _ = star_list(identifier.onboard, CAMERA, random_attitude(rng), 0.5, rng)
    bare = make_identifier(CAMERA, EPOCH_YEAR,
                           replace(identifier.options, magnitude_limit=0.01, time_limit_s=0.1))
    assert bare.identify(centroids).attitude is None


def test_the_stars_of_the_result_are_where_its_attitude_puts_them(identifier):
    rng = np.random.default_rng(11)
    q = random_attitude(rng)
    centroids, _ = star_list(identifier.onboard, CAMERA, q, 0.5, rng)
    result = identifier.identify(centroids)
    known = result.hip > 0
    star = identifier.onboard.direction[identifier.onboard.index_of(result.hip[known])]
    predicted = CAMERA.project(rotate(conjugate(result.attitude.quaternion), star))
    assert np.abs(predicted - centroids.uv[known]).max() < 3


@pytest.mark.slow
def test_near_the_frame_before_the_search_is_in_the_predicted_field(identifier, monkeypatch):
    rng = np.random.default_rng(31)
    turn = np.array([*np.sin(np.radians([0.3, 0.2, 0.1]) / 2), 1.0])
    searched = []

    def whole_sky(*arguments):
        searched.append(arguments)
        return between(*arguments)

    between = type(identifier.pairs).between
    monkeypatch.setattr(type(identifier.pairs), 'between', whole_sky)
    for _ in range(10):
        q = random_attitude(rng)
        centroids, hip = star_list(identifier.onboard, CAMERA, q, 0.5, rng)
        result = identifier.identify_near(centroids, multiply(q, turn / np.linalg.norm(turn)))
        named = result.hip > 0
        np.testing.assert_array_equal(result.hip[named], hip[named])
        assert off_by_deg(result, q) < 0.1
    assert not searched
    # A prediction of another part of the sky costs the time of a search and nothing else.
    result = identifier.identify_near(centroids, random_attitude(rng))
    assert off_by_deg(result, q) < 0.1 and searched
