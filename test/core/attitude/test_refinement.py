# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled attitude refinement against Davenport's method and SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_ros.core.attitude.estimate import cramer_rao, estimate_attitude
from startracker_ros.core.attitude.refinement import refine
from startracker_ros.core.attitude.triad import triad
from startracker_ros.core.maths.rotation import attitude_error, quaternion_from_matrix


def field(rng, stars, half_width=0.1, noise=1e-4):
    """Return sensor and ICRF directions of noisy stars, their sigma and the matrix."""
    matrix = Rotation.random(random_state=rng).as_matrix()
    sensor = np.column_stack([rng.uniform(-half_width, half_width, (stars, 2)), np.ones(stars)])
    sensor /= np.linalg.norm(sensor, axis=1, keepdims=True)
    icrf = sensor @ matrix.T
    sigma = rng.uniform(1, 3, stars) * noise
    sensor = sensor + rng.normal(0, 1, (stars, 3)) * sigma[:, None]
    return sensor / np.linalg.norm(sensor, axis=1, keepdims=True), icrf, sigma, matrix


@pytest.mark.parametrize('stars', [3, 5, 20])
def test_the_best_fit_is_the_one_of_davenport(stars):
    rng = np.random.default_rng(stars)
    for _ in range(50):
        sensor, icrf, sigma, _ = field(rng, stars)
        expected = estimate_attitude(sensor, icrf, sigma)
        matrix = triad(sensor, icrf, 0, stars - 1)
        covariance, determinant = refine(matrix, sensor, icrf, 1 / sigma ** 2)
        assert determinant > 0
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
        error = attitude_error(quaternion_from_matrix(matrix), expected.quaternion)
        bound = np.sqrt(np.diag(expected.covariance_sensor))
        assert (np.abs(error) < 1e-6 * bound + 1e-11).all()
        np.testing.assert_allclose(covariance, cramer_rao(sensor, sigma), rtol=0.05,
                                   atol=1e-3 * covariance.max())


def test_parallel_directions_have_no_attitude():
    sensor = np.tile([0.0, 0.0, 1.0], (3, 1))
    matrix = np.eye(3)
    assert refine(matrix, sensor, sensor, np.ones(3))[1] <= 0


def test_triad_takes_the_first_star_exactly():
    sensor, icrf, _, _ = field(np.random.default_rng(1), 4, noise=1e-3)
    matrix = triad(sensor, icrf, 2, 0)
    np.testing.assert_allclose(matrix @ sensor[2], icrf[2], atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)
