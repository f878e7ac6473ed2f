# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars are associated by their gates, by their neighbours, or not at all."""

import itertools

import numpy as np
import pytest
from skies import CAMERA
from startracker_ros.core.maths.rotation import (
    conjugate, quaternion_from_rotation_vector, random_attitude, rotate)
from startracker_ros.core.papers.neighbourhood import GATE_SIGMA, propagated, star_neighbourhood

SIGMA_PX = 0.15
GATE_PX = GATE_SIGMA * SIGMA_PX
ONBOARD = np.array([[200.0, 300.0], [800.0, 250.0], [420.0, 700.0], [650.0, 560.0], [90.0, 900.0]])


class Field:
    """Five stars of the catalogue at ONBOARD."""

    def __init__(self, rng):
        self.quaternion = random_attitude(rng)
        self.icrf = rotate(self.quaternion, CAMERA.unproject(ONBOARD))

    def assigned(self, predicted, uv, sigma_px=SIGMA_PX):
        return star_neighbourhood(CAMERA, predicted, self.icrf, uv, np.full(len(uv), sigma_px))


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def field(rng):
    return Field(rng)


def test_each_star_alone_in_its_gate_is_found_among_false_ones_in_any_order(field, rng):
    false = rng.uniform(0, 1023, (30, 2))
    assert np.linalg.norm(false[:, None] - ONBOARD, axis=2).min() > 2 * GATE_PX
    uv = np.concatenate([ONBOARD, false]) + rng.normal(0, SIGMA_PX / 3, (35, 2))
    order = rng.permutation(35)
    np.testing.assert_array_equal(field.assigned(ONBOARD, uv[order]), np.argsort(order)[:5])


def test_a_gate_of_two_is_decided_by_the_neighbours(field):
    # The false one is nearer to the prediction, the true one has the right distances.
    predicted = ONBOARD + [0.35, 0.0]
    uv = np.vstack([ONBOARD, ONBOARD[3] + [0.8, 0.1]])
    np.testing.assert_array_equal(field.assigned(predicted, uv), np.arange(5))


@pytest.mark.parametrize('there', [False, True])
def test_a_star_outside_its_gate_is_found_by_three_neighbours_wherever_it_is(field, rng, there):
    predicted = ONBOARD.copy()
    predicted[1] += [-60.0, 35.0]
    uv = np.concatenate([ONBOARD, rng.uniform(0, 1023, (60, 2))])
    expected = np.arange(5)
    if not there:
        uv[1], expected[1] = [5.0, 5.0], -1
    np.testing.assert_array_equal(field.assigned(predicted, uv), expected)


def test_two_neighbours_do_not_name_the_mirror_image_of_a_star(field):
    a, b, c = ONBOARD[:3]
    along = (b - a) / np.linalg.norm(b - a)
    mirrored = a + 2 * along * ((c - a) @ along) - (c - a)
    uv = np.array([a, b, mirrored])
    np.testing.assert_array_equal(field.assigned(ONBOARD, uv), [0, 1, -1, -1, -1])
    # A third neighbour that does not agree does not help.
    uv = np.array([a, b, mirrored, ONBOARD[3]])
    np.testing.assert_array_equal(field.assigned(ONBOARD, uv), [0, 1, -1, 3, -1])


def test_a_false_star_in_a_gate_does_not_outvote_the_neighbours_of_another(field):
    # Star 4 is missing and a false star is in its gate; star 3 has to choose.
    uv = np.vstack([ONBOARD, ONBOARD[3] + [0.0, 0.5]])
    uv[4] += [0.55, 0.2]
    np.testing.assert_array_equal(field.assigned(ONBOARD, uv), np.arange(5))


def test_one_centroid_between_two_stars_is_given_to_one_at_most(rng):
    close = np.array([[500.0, 500.0], [500.5, 500.0], [200.0, 300.0], [800.0, 250.0],
                      [420.0, 900.0]])
    q = random_attitude(rng)
    icrf = rotate(q, CAMERA.unproject(close))
    assigned = star_neighbourhood(CAMERA, close, icrf, close[1:], np.full(4, SIGMA_PX))
    np.testing.assert_array_equal(assigned[2:], [1, 2, 3])
    assert sorted(assigned[:2]) == [-1, 0]
    without = star_neighbourhood(CAMERA, close[:2], icrf[:2], close[1:2], np.full(1, SIGMA_PX))
    np.testing.assert_array_equal(without, [-1, -1])


def test_nothing_is_invented(field, rng):
    none = np.full(5, -1)
    np.testing.assert_array_equal(field.assigned(ONBOARD, np.empty((0, 2))), none)
    assert not len(star_neighbourhood(CAMERA, ONBOARD[:0], field.icrf[:0], ONBOARD,
                                      np.full(5, SIGMA_PX)))
    np.testing.assert_array_equal(
        field.assigned(np.full((5, 2), np.nan), ONBOARD), none)
    named = 0
    for _ in range(200):
        named += np.count_nonzero(field.assigned(ONBOARD, rng.uniform(0, 1023, (30, 2))) >= 0)
    # 200 x 30 false stars in 5 gates of 1.3 px^2: 0.04 are expected.
    assert named <= 1


def test_a_centroid_is_given_once_and_agrees_with_the_catalogue(rng):
    for _ in range(100):
        field = Field(rng)
        true = ONBOARD + rng.normal(0, SIGMA_PX, ONBOARD.shape)
        there = rng.random(5) < 0.8
        near = ONBOARD[rng.integers(5, size=6)] + rng.normal(0, 2 * GATE_PX, (6, 2))
        uv = np.concatenate([true[there], near, rng.uniform(0, 1023, (40, 2))])
        assigned = field.assigned(ONBOARD + rng.normal(0, SIGMA_PX, ONBOARD.shape), uv)
        used = assigned[assigned >= 0]
        assert len(np.unique(used)) == len(used) and used.max(initial=-1) < len(uv)
        sensor = CAMERA.unproject(uv)
        for i, j in itertools.combinations(np.flatnonzero(assigned >= 0), 2):
            apart = np.arccos(sensor[assigned[i]] @ sensor[assigned[j]])
            known = np.arccos(field.icrf[i] @ field.icrf[j])
            # Both have errors to the radius of a gate about an uncertain prediction.
            assert abs(apart - known) <= (2 * GATE_PX + 8 * SIGMA_PX) * CAMERA.pixel_rad


def test_pixels_are_propagated_as_the_camera_turns(field):
    rate, dt_s = np.array([0.01, -0.02, 0.15]), 0.1
    later = rotate(conjugate(quaternion_from_rotation_vector(rate * dt_s)),
                   CAMERA.unproject(ONBOARD))
    np.testing.assert_allclose(propagated(CAMERA, ONBOARD, rate, dt_s), CAMERA.project(later),
                               atol=1e-9)
    there_and_back = propagated(CAMERA, propagated(CAMERA, ONBOARD, rate, dt_s), -rate, dt_s)
    np.testing.assert_allclose(there_and_back, ONBOARD, atol=1e-9)
