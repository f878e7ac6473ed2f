# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sets of bright stars by their Hausdorff distance: the distance, the sets, the results."""

from dataclasses import replace
from itertools import count, islice
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.distance import directed_hausdorff
from skies import frame, SMALL_CAMERA as CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify import identification
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import (
    attitude_error, quaternion_from_pointing, radec_from_unit, random_attitude)
from startracker_ros.core.papers.hausdorff import (
    bright_sets, brightest_around, hausdorff_distance, Pivots, star_sets)

EPOCH_YEAR = 2000.0


def make(method, camera=CAMERA, **options):
    # No search ends for the machine's speed.
    options = {'magnitude_limit': 6.0, 'time_limit_s': 600.0, **options}
    return make_identifier(camera, EPOCH_YEAR, IdentificationOptions(
        method=f'hausdorff_{method}', **options))


@pytest.fixture(scope='module')
def identifiers():
    return {method: make(method) for method in ('pivot', 'segment')}


@pytest.fixture(params=['pivot', 'segment'])
def identifier(request, identifiers):
    return identifiers[request.param]


def right(result, q):
    error = np.abs(np.degrees(attitude_error(result.attitude.quaternion, q)))
    return np.hypot(error[0], error[1]) < 0.05 and error[2] < 0.5


def random_units(rng, count):
    vectors = rng.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_the_distance_is_that_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = rng.normal(size=(2, 2)), rng.normal(size=(3, 2))
        distance = np.linalg.norm(a[:, None] - b, axis=-1)
        expected = max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0])
        assert hausdorff_distance(distance) == pytest.approx(expected, rel=1e-12)


def test_the_brightest_around_are_those_of_a_slow_search():
    rng = np.random.default_rng(1)
    direction = random_units(rng, 300)
    own = np.arange(0, 300, 7)
    for pivots in (Pivots(direction[own], own), Pivots(random_units(rng, 40))):
        found = brightest_around(direction, pivots, 0.3, 4)
        for row, pivot in enumerate(pivots.direction):
            near = np.flatnonzero(np.arccos(np.clip(direction @ pivot, -1, 1)) <= 0.3)
            if pivots.star is not None:
                near = near[near != pivots.star[row]]
            expected = np.pad(near[:4], (0, max(4 - len(near), 0)), constant_values=-1)
            np.testing.assert_array_equal(found[row], expected)


def test_a_set_is_stored_as_the_paper_defines_it():
    """Pivot at the origin of the tangent plane, brightest east, three others."""
    plane = np.array([[0, 0], [0.06, 0], [0, 0.01], [0.05, 0.02], [-0.03, -0.04]])
    direction = np.column_stack([np.ones(5), plane])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    around = np.array([[1, 2, 3, 4]])
    by_star = star_sets(direction, Pivots(direction[:1], np.zeros(1, int)), around, (0, 1, 2, 3))
    # Star 4 is 0.05 from the pivot, farther than any other star is from the other set.
    assert by_star.feature[0] == pytest.approx(0.05, rel=1e-12)
    np.testing.assert_array_equal(by_star.stars, [[0, 1, 4, 2, 3]])
    by_node = star_sets(direction, Pivots(direction[:1]), around, (0, 1, 2, 3))
    assert by_node.feature[0] == by_star.feature[0]
    np.testing.assert_array_equal(by_node.stars, [[1, 4, 2, 3]])
    none = star_sets(direction, Pivots(direction[:1]), np.array([[1, 2, 3, -1]]), (0, 1, 2, 3))
    assert len(none.feature) == 0 and none.stars.shape == (0, 4)


def test_the_circle_is_that_of_the_paper(identifiers):
    for identifier in identifiers.values():
        assert np.degrees(identifier.radius_rad) == pytest.approx(6.0, abs=1e-9)
    assert len(identifiers['segment'].pivots.direction) == 361 * 181
    assert len(identifiers['pivot'].pivots.direction) == len(identifiers['pivot'].onboard)


@pytest.mark.parametrize('method, least', [('pivot', 0.95), ('segment', 0.97)])
def test_random_attitudes(identifiers, method, least):
    rng = np.random.default_rng(2)
    solved, count = 0, 50
    for _ in range(count):
        q = random_attitude(rng)
        centroids, hip = star_list(identifiers[method].onboard, CAMERA, q, 0.1, rng)
        result = identifiers[method].identify(centroids)
        if result.attitude is not None:
            assert right(result, q)
            known = result.hip > 0
            np.testing.assert_array_equal(result.hip[known], hip[known])
            solved += 1
    assert solved >= least * count


def test_false_and_missing_stars(identifier):
    """A false star brighter than all, the brightest star missing."""
    rng = np.random.default_rng(3)
    solved, count = 0, 30
    for _ in range(count):
        q = random_attitude(rng)
        centroids, _ = star_list(identifier.onboard, CAMERA, q, 0.1, rng)
        uv = np.concatenate([rng.uniform(0, 511, (1, 2)), centroids.uv[1:]])
        result = identifier.identify(frame(uv))
        if result.attitude is not None:
            assert right(result, q)
            solved += 1
    assert solved >= 0.8 * count


def test_no_result_where_there_is_none(identifier):
    rng = np.random.default_rng(4)
    for _ in range(5):
        centroids, _ = star_list(identifier.onboard, CAMERA, random_attitude(rng), 0.1, rng)
        for uv in (rng.uniform(0, 511, (15, 2)), centroids.uv * [-1, 1] + [511, 0]):
            result = identifier.identify(frame(uv))
            assert result.status == 'no_candidate' and result.reason
            assert result.attitude is None and not result.hip.any()


@pytest.mark.parametrize('width, height, cx', [(640, 480, 300.0), (480, 640, 239.5)])
def test_other_cameras(identifier, width, height, cx):
    """Neither square nor centred."""
    camera = Camera(width, height, 2500.0, 2450.0, cx, (height - 1) / 2)
    rng = np.random.default_rng(5)
    other = type(identifier)(camera, EPOCH_YEAR, identifier.options)
    solved = 0
    for _ in range(15):
        q = random_attitude(rng)
        centroids, _ = star_list(other.onboard, camera, q, 0.1, rng)
        result = other.identify(centroids)
        if result.attitude is not None:
            assert right(result, q)
            solved += 1
    assert solved >= 14


def test_the_nearest_distance_names_a_field_about_a_star(identifiers):
    """As published: exact positions, a star of the database at the centre."""
    identifier = identifiers['pivot']
    rng = np.random.default_rng(6)
    everyone = make('pivot', max_image_stars=100)
    named, count = 0, 40
    for star in rng.choice(len(identifier.onboard), count, replace=False):
        q = quaternion_from_pointing(
            *radec_from_unit(identifier.onboard.direction[star]), rng.uniform(0, 6))
        centroids, hip = star_list(identifier.onboard, CAMERA, q, 0.0, rng, magnitude_sigma=0.0)
        field = everyone.field_stars(centroids)
        found = everyone.nearest(field)
        assert found.stars.shape == (1, 5) and len(found.base) == 5
        assert hip[field.index[found.base[0]]] == identifier.onboard.hip[star]
        named += np.array_equal(hip[field.index[found.base]],
                                identifier.onboard.hip[found.stars[0]])
    # Two stars may be each other's distance: at equal separations the nearest is a toss.
    assert named >= 0.9 * count


def test_a_lone_pivot_has_no_nearest_set(identifier):
    field = identifier.field_stars(frame([[255, 255], [5, 5], [505, 505], [5, 505], [505, 5],
                                          [300, 255]]))
    assert identifier.nearest(field) is None


def test_a_set_is_the_same_at_every_roll_and_scale_of_brightness(identifier):
    rng = np.random.default_rng(7)
    for _ in range(10):
        direction = identifier.onboard.direction[
            identifier.onboard.within(random_units(rng, 1)[0], 0.1)]
        centre = direction.mean(0) / np.linalg.norm(direction.mean(0))
        turned, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        sets = [bright_sets(each, Pivots(pivot[None]), 0.1)
                for each, pivot in ((direction, centre), (direction @ turned, centre @ turned))]
        np.testing.assert_allclose(sets[0].feature, sets[1].feature, rtol=1e-9)
        np.testing.assert_array_equal(sets[0].stars, sets[1].stars)


def test_useless_rows_are_left_out(identifier):
    rng = np.random.default_rng(8)
    q = random_attitude(rng)
    centroids, _ = star_list(identifier.onboard, CAMERA, q, 0.1, rng)
    bad = [[np.nan, 5.0], [-50.0, 10.0], [1e6, 1e6], *(centroids.uv[:3] + 0.2)]
    result = identifier.identify(frame(
        np.concatenate([bad, centroids.uv]), np.concatenate([np.full(6, 1e9), centroids.flux])))
    assert result.status == 'identified' and right(result, q)
    assert not result.hip[:3].any()


@pytest.mark.parametrize('uv, status', [
    (np.empty((0, 2)), 'too_few_stars'),
    (np.full((30, 2), np.nan), 'too_few_stars'),
    (np.full((30, 2), 255.5), 'too_few_stars'),
    (np.array([[10.0, 10], [500, 40], [300, 300]]), 'too_few_stars'),
    (np.column_stack([np.linspace(20, 490, 12), np.full(12, 255.5)]), 'no_candidate'),
    (np.stack(np.meshgrid(*[np.linspace(50, 460, 5)] * 2), -1).reshape(-1, 2), 'no_candidate'),
])
def test_images_without_a_result_have_a_reason(identifier, uv, status):
    result = identifier.identify(frame(uv))
    assert result.status == status and result.attitude is None
    assert len(result.hip) == len(uv) and not result.hip.any()
    assert 'usable stars' in result.reason or 'candidates tested' in result.reason


def test_thousands_of_centroids_are_bounded_work(identifier, monkeypatch):
    """With a clock that advances by one second per reading: it is read once for each base."""
    rng = np.random.default_rng(9)
    centroids = frame(rng.uniform(0, 511, (5000, 2)), sigma_px=0.3)
    limited = type(identifier)(CAMERA, EPOCH_YEAR, replace(
        identifier.options, max_image_stars=200, time_limit_s=100.0))
    monkeypatch.setattr(identification, 'time', SimpleNamespace(
        thread_time=count().__next__, monotonic=lambda: 0.0))
    result = limited.identify(centroids)
    field = limited.field_stars(centroids)
    tested = [len(found.stars) for found in islice(limited.candidates(field), 101)]
    assert len(field) == 200 and max(tested) <= 20
    assert result.status == 'time_limit'
    assert result.reason == (
        f'not identified within time_limit_s = 100, {sum(tested)} candidates tested')


@pytest.mark.parametrize('method', ['pivot', 'segment'])
def test_a_sky_without_sets_gives_no_result(method):
    rng = np.random.default_rng(10)
    identifier = make(method, magnitude_limit=0.01)
    uv = rng.uniform(0, 511, (10, 2))
    assert identifier.identify(frame(uv)).status == 'no_candidate'
    assert identifier.nearest(identifier.field_stars(frame(uv))) is None


def written_out_feature(directions, own, radius_rad):
    """Return the feature of one pivot by the equations of the paper, star by star."""
    pivot = directions[own]
    a0, d0 = np.arctan2(pivot[1], pivot[0]), np.arcsin(pivot[2])
    places = []
    for star, vector in enumerate(directions):
        if star != own and vector @ pivot >= np.cos(radius_rad):
            a, d = np.arctan2(vector[1], vector[0]), np.arcsin(vector[2])
            below = np.sin(d) * np.sin(d0) + np.cos(d) * np.cos(d0) * np.cos(a - a0)
            places.append((np.cos(d) * np.sin(a - a0) / below,
                           (np.sin(d) * np.cos(d0) - np.cos(d) * np.sin(d0) * np.cos(a - a0))
                           / below))
    if len(places) < 4:
        return None
    first, second = [(0.0, 0.0), places[0]], places[1:4]

    def one_way(one, other):
        return max(min(np.hypot(x - u, y - v) for u, v in other) for x, y in one)

    return max(one_way(first, second), one_way(second, first))


def test_the_features_are_those_of_an_independent_implementation():
    rng = np.random.default_rng(17)
    direction = random_units(rng, 700)
    pivots = Pivots(direction[:150], np.arange(150))
    radius_rad = np.radians(9.0)
    expected = [written_out_feature(direction, own, radius_rad) for own in pivots.star]
    expected = sorted(value for value in expected if value is not None)
    sets = bright_sets(direction, pivots, radius_rad)
    assert 20 < len(expected) < 150
    np.testing.assert_allclose(np.sort(sets.feature), expected, rtol=0, atol=1e-12)
