# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rotations against SciPy, and the celestial conventions against known answers."""

import csv

from hypothesis import given, strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_ros.core.maths import rotation

angles = st.floats(-3.1, 3.1)
rotation_vectors = st.tuples(angles, angles, angles).map(np.array).filter(
    lambda v: np.linalg.norm(v) < 3.1)


@given(rotation_vectors, st.sampled_from([-1, 1]))
def test_agrees_with_scipy(vector, sign):
    q = sign * rotation.quaternion_from_rotation_vector(vector)
    reference = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(rotation.matrix_from_quaternion(q), reference.as_matrix(),
                               atol=1e-12)
    np.testing.assert_allclose(rotation.rotation_vector_from_quaternion(q), vector, atol=1e-9)
    from_matrix = rotation.quaternion_from_matrix(reference.as_matrix())
    assert abs(from_matrix @ q) == pytest.approx(1, abs=1e-14)
    probe = np.array([0.2, -0.5, 0.8])
    np.testing.assert_allclose(rotation.rotate(q, probe), reference.apply(probe), atol=1e-12)


@given(rotation_vectors, rotation_vectors)
def test_product_applies_right_factor_first(first, second):
    a, b = map(rotation.quaternion_from_rotation_vector, (second, first))
    expected = (Rotation.from_rotvec(second) * Rotation.from_rotvec(first)).as_matrix()
    np.testing.assert_allclose(
        rotation.matrix_from_quaternion(rotation.multiply(a, b)), expected, atol=1e-12)


def test_tiny_rotations_keep_their_length():
    vector = np.array([3e-9, -4e-9, 0.0])
    q = rotation.quaternion_from_rotation_vector(vector)
    np.testing.assert_allclose(rotation.rotation_vector_from_quaternion(q), vector, rtol=1e-12)


@given(rotation_vectors, st.tuples(*[st.floats(-1e-3, 1e-3)] * 3).map(np.array))
def test_attitude_error_is_about_sensor_axes(vector, error):
    truth = rotation.quaternion_from_rotation_vector(vector)
    estimate = rotation.multiply(truth, rotation.quaternion_from_rotation_vector(error))
    np.testing.assert_allclose(rotation.attitude_error(-estimate, truth), error, atol=1e-12)


@given(st.floats(0, 6.28), st.floats(-1.55, 1.55), st.floats(0, 6.28))
def test_pointing_round_trip(ra, dec, roll):
    q = rotation.quaternion_from_pointing(ra, dec, roll)
    again = rotation.quaternion_from_pointing(*rotation.pointing_from_quaternion(q))
    assert abs(q @ again) == pytest.approx(1, abs=1e-13)


def test_roll_zero_puts_north_up_and_east_left():
    q = rotation.quaternion_from_pointing(np.radians(83.0), np.radians(-1.0), 0.0)
    in_sensor = rotation.conjugate(q)
    north = rotation.rotate(in_sensor, rotation.unit_from_radec(np.radians(83.0), np.radians(1.0)))
    east = rotation.rotate(in_sensor, rotation.unit_from_radec(np.radians(85.0), np.radians(-1.0)))
    assert north[1] < -0.03 and abs(north[0]) < 1e-6
    assert east[0] < -0.03 and abs(east[1]) < 1e-3


def test_known_quaternions_point_where_the_photographs_point(sky_data):
    with open(sky_data / 'night-sky-11deg' / 'solutions.csv') as file:
        for row in csv.DictReader(file):
            q = np.array([float(row[name]) for name in ('qx', 'qy', 'qz', 'qw')])
            ra, dec, _ = rotation.pointing_from_quaternion(q / np.linalg.norm(q))
            assert np.degrees(ra) == pytest.approx(float(row['ra_deg']), abs=1e-3)
            assert np.degrees(dec) == pytest.approx(float(row['dec_deg']), abs=1e-3)


def test_one_rotation_is_computed_as_each_of_many():
    rng = np.random.default_rng(1)
    vectors, a, b = rng.normal(0, 1, (50, 3)), rng.normal(0, 1, (50, 4)), rng.normal(0, 1, (50, 4))
    np.testing.assert_array_equal(rotation.multiply(a, b), [*map(rotation.multiply, a, b)])
    np.testing.assert_array_equal(rotation.quaternion_from_rotation_vector(vectors),
                                  [*map(rotation.quaternion_from_rotation_vector, vectors)])


def test_sign_continuity():
    q = np.array([0.1, 0.2, 0.3, -0.9]) / np.linalg.norm([0.1, 0.2, 0.3, -0.9])
    assert rotation.sign_continuous(q, None)[3] > 0
    np.testing.assert_array_equal(rotation.sign_continuous(-q, q), q)


def test_a_turn_about_sensor_axes_and_a_mean():
    turn = np.array([0.1, -0.2, 0.3])
    for start in (*Rotation.random(50, random_state=np.random.default_rng(2)),
                  *Rotation.from_rotvec(np.pi * np.eye(3))):
        q = rotation.turned(start.as_quat(), turn)
        expected = (start * Rotation.from_rotvec(turn)).as_matrix()
        np.testing.assert_allclose(rotation.matrix_from_quaternion(q), expected, atol=1e-14)
        # Half turns about an axis leave each of its branches nearly singular.
        again = rotation.quaternion_from_matrix(start.as_matrix())
        assert again[3] >= 0
        np.testing.assert_allclose(rotation.matrix_from_quaternion(again), start.as_matrix(),
                                   atol=1e-12)
    around = np.array([rotation.turned(q, sign * turn) for sign in (-1, 0, 1)])
    np.testing.assert_allclose(rotation.attitude_error(rotation.mean_attitude(around), q), 0,
                               atol=1e-12)
