# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A few stars of the real sky among many false spots, in a field that is given to 5 %."""

from native_core import kernels
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import (
    attitude_error, matrix_from_quaternion, random_attitude)
from startracker_ros.photographs.few_stars import few_stars, image_area
from startracker_ros.photographs.ladder import LadderIdentifier, UncalibratedPyramid
from startracker_ros.photographs.sky_triangles import sky_triangles

SIDE_PX, FOV_DEG, NOISE_PX = 1024, 15.0, 0.3
WIDE = IdentificationOptions(fov_error_percent=5.0)
LIMIT = 1e-6


@pytest.fixture(scope='module')
def identifier():
    return UncalibratedPyramid(Camera.from_fov(SIDE_PX, SIDE_PX, FOV_DEG), 2015.0, WIDE)


@pytest.fixture(scope='module')
def table(identifier):
    return sky_triangles(identifier.onboard, image_area(identifier.camera)).table


def spots(rng, uv):
    """Return centroids whose order of brightness says nothing."""
    count = len(uv)
    return Centroids(uv, rng.permutation(count) + 100.0, np.full(count, 50.0),
                     np.full(count, NOISE_PX))


def draw(rng, identifier, scale, stars, false):
    """Return an attitude, and the brightest stars of its field, some missing, with false spots."""
    camera = Camera.from_fov(SIDE_PX, SIDE_PX, FOV_DEG).with_focal_ratio(scale)
    direction = identifier.onboard.direction
    while True:
        quaternion = random_attitude(rng)
        seen = direction @ matrix_from_quaternion(quaternion)
        uv = camera.project(seen[seen[:, 2] > np.cos(camera.corner_angle_rad)])
        uv = uv[camera.contains(uv, 0)]
        uv = uv[rng.random(len(uv)) < 0.85][:stars]
        if len(uv) == stars:
            return quaternion, spots(rng, np.concatenate([
                uv + rng.normal(0, NOISE_PX, uv.shape), rng.uniform(0, SIDE_PX - 1, (false, 2))]))


@pytest.mark.parametrize('scale', [0.96, 1.0, 1.04])
def test_six_stars_of_66_spots_are_found(identifier, table, scale):
    """Were one of five not found, fewer than 7 of 12 would be so once in a thousand times."""
    rng, found = np.random.default_rng(3), 0
    for _ in range(12):
        truth, centroids = draw(rng, identifier, scale, 6, 60)
        result, _ = few_stars(identifier, table, centroids, 0.3, LIMIT, 10.0)
        if result.attitude is None:
            continue
        error = attitude_error(result.attitude.quaternion, truth)
        assert (np.abs(error) < 5 * np.sqrt(result.attitude.covariance_sensor.diagonal())).all()
        assert result.matched >= 5 and result.focal_ratio == pytest.approx(scale, abs=0.003)
        found += 1
    assert found >= 7


@pytest.mark.slow
def test_false_spots_have_no_attitude_and_an_honest_probability(identifier, table):
    """At most a share x of lists of false spots has a probability of x."""
    rng, least = np.random.default_rng(4), []
    for _ in range(40):
        centroids = spots(rng, rng.uniform(0, SIDE_PX - 1, (66, 2)))
        result, _ = few_stars(identifier, table, centroids, 0.3, LIMIT, 10.0)
        assert result.attitude is None
        least.append(result.false_alarm_probability)
    # Of 40 draws of a probability of 0.1, more than 11 are so in one of a thousand sets.
    assert np.count_nonzero(np.array(least) <= 0.1) <= 11
    # The search does meet fields that agree by chance.
    assert min(least) < 1


def test_triangles_of_a_table_are_those_of_the_sky(identifier, table):
    rng, direction = np.random.default_rng(5), identifier.onboard.direction
    for row in rng.integers(len(table.side), size=200):
        a, b, c = direction[table.star[row]]
        sides = [2 * np.arcsin(np.linalg.norm(x - y) / 2) for x, y in ((b, c), (a, c), (a, b))]
        np.testing.assert_allclose(table.side[row], sides, rtol=1e-5)
        assert sides == sorted(sides, reverse=True)
    assert table.start[-1] == len(table.side)


def test_the_probability_is_the_number_of_chance_fields():
    """Of five of five spots it is known in simple numbers: k = m = S = 5, a square of 1 rad."""
    x, e = 1e-3, 0.05
    expected = (120 * 4 * np.pi * 4 * np.pi * e * 20 / 6 * (np.pi * x) ** 3 / 6)
    choices = 2 * 1 * (1 + np.log(120)) * 4
    probability = kernels().stt_few_star_probability
    assert probability(5, 5, 5, 5, 5, x, 1.0, 1.0, 1.0, e) == pytest.approx(expected * choices)
    # The faintest of them is the sixth of ten: it may be any from the fifth on.
    assert probability(10, 5, 6, 5, 5, x, 1.0, 1.0, 1.0, e) == pytest.approx(
        6 * expected * choices * sum(5 / i for i in range(5, 11)))
    # Or any five of ten are stars.
    assert probability(10, 5, 10, 5, 5, x, 1.0, 1.0, 1.0, e) == pytest.approx(
        252 * expected * choices)
    assert probability(50, 3, 3, 3, 20, 1e-9, 1.0, 1.0, 1.0, e) == 1.0


@pytest.mark.slow
def test_the_ladder_finds_few_stars(identifier):
    """Its other searches do not find these."""
    ladder, rng = LadderIdentifier(identifier.camera, 2015.0, WIDE), np.random.default_rng(6)
    found = 0
    for _ in range(4):
        truth, centroids = draw(rng, identifier, 1.03, 6, 60)
        first = next((attempt for attempt in ladder.identify([centroids])
                      if attempt.identification.attitude is not None), None)
        if first is not None:
            error = attitude_error(first.identification.attitude.quaternion, truth)
            assert np.linalg.norm(error) < np.radians(0.1)
            found += 1
    assert found >= 2
