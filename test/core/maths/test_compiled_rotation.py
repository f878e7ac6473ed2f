# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled rotations against SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_ros.core.maths import compiled_rotation, rotation
from startracker_ros.core.maths.compiled_rotation import rotation_between

RNG = np.random.default_rng(2)
# Half turns about every axis leave each of the four branches nearly singular.
TURNS = [Rotation.random(random_state=RNG) for _ in range(200)] + [
    Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)]


@pytest.mark.parametrize('convert', [
    compiled_rotation.quaternion_from_matrix, rotation.quaternion_from_matrix])
def test_quaternion_of_every_matrix(convert):
    for turn in TURNS:
        q = convert(turn.as_matrix())
        assert q[3] >= 0
        np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), turn.as_matrix(), atol=1e-12)


def test_matrices():
    for turn in TURNS:
        matrix = turn.as_matrix()
        np.testing.assert_allclose(
            compiled_rotation.matrix_from_quaternion(turn.as_quat()), matrix, atol=1e-14)
        np.testing.assert_allclose(
            compiled_rotation.matrix_from_rotation_vector(turn.as_rotvec()), matrix, atol=1e-14)


@pytest.mark.parametrize('size', [0.0, 1e-12, 1e-3, 2.0])
def test_turns_about_sensor_axes(size):
    vector = size * np.array([0.6, -0.48, 0.64])
    expected = (TURNS[0] * Rotation.from_rotvec(vector)).as_matrix()
    q = compiled_rotation.turned(TURNS[0].as_quat(), vector)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), expected, atol=1e-14)
    matrix = TURNS[0].as_matrix()
    compiled_rotation.turn_matrix(matrix, *(np.tan(size / 2) * np.array([0.6, -0.48, 0.64])))
    np.testing.assert_allclose(matrix, expected, atol=1e-14)


def test_directions_on_sensor_axes():
    icrf = RNG.normal(0, 1, (5, 3))
    sensor = compiled_rotation.sensor_directions(TURNS[0].as_matrix(), icrf)
    np.testing.assert_allclose(sensor, TURNS[0].inv().apply(icrf), atol=1e-14)


def test_products_and_differences_of_single_quaternions_are_those_of_arrays():
    rng = np.random.default_rng(8)
    for _ in range(20):
        a, b = rotation.random_attitude(rng), rotation.random_attitude(rng)
        error = rotation.attitude_error(b, a)
        np.testing.assert_allclose(rotation_between(a, b), error, atol=1e-12)
        np.testing.assert_allclose(rotation_between(a, -b), error, atol=1e-12)
    assert not rotation_between(a, a).any()
