# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lines of sight and the position of the target."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.locate.line_of_sight import (
    line_of_sight, LineOfSight, without_aberration)
from startracker_ros.core.locate.location import locate, LocationError, LocationOptions
from startracker_ros.core.locate.triangulation import LOCATED, triangulate
from startracker_ros.core.maths.rotation import ARCSEC, quaternion_from_pointing, rotate

TARGET = np.array([7.45e6, 2.1e5, 3e4])
OBSERVERS = np.array([[7.07e6, 0.0, 0.0], [7.05e6, 4.9e5, 1e3]])
LEAST_SQUARES = LocationOptions(solution='least_squares')


def towards(position, target=TARGET, *, position_m=10.0, direction_rad=24 * ARCSEC):
    line = target - position
    line = line / np.linalg.norm(line)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = position_m ** 2 * np.eye(3)
    covariance[3:, 3:] = direction_rad ** 2 * (np.eye(3) - np.outer(line, line))
    return LineOfSight(position, line, covariance)


def drawn(rng, one):
    error = rng.multivariate_normal(np.zeros(6), one.covariance)
    line = one.direction + error[3:]
    return replace(one, position_m=one.position_m + error[:3],
                   direction=line / np.linalg.norm(line))


@pytest.mark.parametrize('options', [LocationOptions(), LEAST_SQUARES])
@pytest.mark.parametrize('baseline_deg', [0.6, 4.0, 20.0, 90.0])
def test_exact_without_noise(options, baseline_deg):
    turn = Rotation.from_euler('z', baseline_deg / 2, degrees=True)
    middle = np.array([7.07e6, 0.0, 0.0])
    first, second = turn.inv().apply(middle), turn.apply(middle)
    target = 1.1 * middle + [0, 1e4, 2e4]
    found = locate(towards(first, target), towards(second, target), options)
    assert np.linalg.norm(found.position_m - target) < 1e-6
    np.testing.assert_allclose(found.range_m, [np.linalg.norm(target - first),
                                               np.linalg.norm(target - second)])


def test_least_squares_solves_the_cross_product_equations():
    rng = np.random.default_rng(3)
    first, second = (drawn(rng, towards(position)) for position in OBSERVERS)
    rows, right = [], []
    for one in (first, second):
        x, y, z = one.direction
        matrix = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
        rows.append(matrix)
        right.append(matrix @ one.position_m)
    theirs = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    np.testing.assert_allclose(locate(first, second, LEAST_SQUARES).position_m, theirs, atol=1e-5)


def test_weighted_solution_is_the_maximum_likelihood_position():
    """Against a general minimiser of the angles and positions, with unequal observers."""
    rng = np.random.default_rng(4)
    first = drawn(rng, towards(OBSERVERS[0], direction_rad=60 * ARCSEC))
    second = drawn(rng, towards(OBSERVERS[1], direction_rad=6 * ARCSEC, position_m=40.0))

    def residuals(unknown):
        target, moved = unknown[:3] * 1e3 + TARGET, unknown[3:].reshape(2, 3)
        parts = [unknown[3:6], unknown[6:9]]
        for one, shift, angle, sigma in ((first, moved[0], 60, 10), (second, moved[1], 6, 40)):
            line = target - one.position_m - shift * sigma
            parts.append((line / np.linalg.norm(line) - one.direction) / (angle * ARCSEC))
        return np.concatenate(parts)
    theirs = least_squares(residuals, np.zeros(9), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = locate(first, second)
    np.testing.assert_allclose(found.position_m, theirs.x[:3] * 1e3 + TARGET, atol=0.2)
    # In the plane of both lines nothing is left over to be weighted.
    worse = locate(first, second, LEAST_SQUARES)
    assert found.covariance_m2[2, 2] < 0.5 * worse.covariance_m2[2, 2]


@pytest.mark.slow
@pytest.mark.parametrize('weighted', [True, False])
def test_covariance_is_that_of_the_errors(weighted):
    rng = np.random.default_rng(5)
    lines = [towards(OBSERVERS[0], direction_rad=40 * ARCSEC), towards(OBSERVERS[1])]
    count = 10000
    pairs = [[drawn(rng, one) for one in lines] for _ in range(count)]
    status, position, covariance, *_ = triangulate(
        np.array([[one.position_m for one in pair] for pair in pairs]),
        np.array([[one.direction for one in pair] for pair in pairs]),
        np.array([[one.covariance for one in pair] for pair in pairs]), weighted, 100.0, 0.01)
    assert (status == LOCATED).all()
    error = position - TARGET
    squared = np.einsum('ni,nij,nj->n', error, np.linalg.inv(covariance), error)
    # Its mean is 3 with a sigma of sqrt(6 / N).
    assert abs(squared.mean() - 3) < 4 * np.sqrt(6 / count)
    np.testing.assert_allclose(np.cov(error.T), covariance[0], rtol=0.1, atol=60)


BASE = towards(OBSERVERS[0])
OTHER = towards(OBSERVERS[1])


@pytest.mark.parametrize('first, second, words', [
    (BASE, replace(OTHER, direction=BASE.direction), 'parallel within 0.5 deg: 0 deg'),
    (BASE, replace(OTHER, direction=-BASE.direction), 'parallel within'),
    (BASE, replace(OTHER, position_m=BASE.position_m + 1.0), 'observers 1.73 m apart'),
    (BASE, replace(OTHER, position_m=BASE.position_m), 'observers 0 m apart'),
    (replace(BASE, direction=-BASE.direction), OTHER, 'behind the first observer'),
    (BASE, replace(OTHER, direction=-OTHER.direction), 'behind the second observer'),
    (BASE, replace(OTHER, direction=np.full(3, np.nan)), 'NaN or infinity'),
    (replace(BASE, position_m=np.array([7e6, np.inf, 0])), OTHER, 'NaN or infinity'),
    (BASE, replace(OTHER, direction=np.zeros(3)), 'unit length'),
    (BASE, replace(OTHER, covariance=np.full((6, 6), np.nan)), 'covariance'),
    (BASE, replace(OTHER, covariance=np.zeros((6, 6))), 'covariance'),
    (BASE, towards(OBSERVERS[1], TARGET + [0, 0, 2e3]), 'do not point to one target'),
])
def test_lines_without_a_position_are_rejected(first, second, words):
    with pytest.raises(LocationError, match=words):
        locate(first, second)


@pytest.mark.parametrize('camera', [
    Camera(1024, 1024, 5000.0, 5100.0, 500.0, 520.0, (0.1, 0.01, 1e-3, 2e-3, 0.0)),
    Camera(1024, 1024, 300.0, 310.0, 500.0, 520.0, (-0.02, 0.004, 0.0, 0.0), 'equidistant')])
def test_line_of_sight_through_a_real_lens(camera):
    """Direction by the camera model, covariance by drawing attitudes and centroids."""
    q, uv = quaternion_from_pointing(1.0, 0.3, 0.2), np.array([200.0, 700.0])
    turn = np.diag([10.0, 20.0, 60.0]) * ARCSEC
    mixed = Rotation.from_rotvec([0.3, 1.0, -0.4]).as_matrix() @ turn
    one = line_of_sight(camera, uv, 0.4, q, mixed @ mixed.T, OBSERVERS[0], 25.0 * np.eye(3))
    np.testing.assert_allclose(one.direction, rotate(q, camera.unproject(uv)), atol=1e-15)
    rng = np.random.default_rng(6)
    lines = rotate(q, camera.unproject(uv + rng.normal(0, 0.4, (40000, 2))))
    lines = lines + np.cross(rng.standard_normal((40000, 3)) @ mixed.T, lines)
    np.testing.assert_allclose(np.cov(lines.T), one.covariance[3:, 3:],
                               atol=0.03 * np.abs(one.covariance[3:, 3:]).max())
    np.testing.assert_array_equal(one.covariance[:3, :3], 25.0 * np.eye(3))
    assert not one.covariance[:3, 3:].any()
    with pytest.raises(ValueError, match='is not an attitude'):
        line_of_sight(camera, uv, 0.4, np.zeros(4), np.eye(3), OBSERVERS[0], np.eye(3))


def test_aberration_of_target_and_stars_is_taken_out():
    """The attitude of a camera whose stars are all aberrated, and a target that is, too."""
    orbital, solar = np.array([0.0, 7500.0, 0.0]), np.array([20e3, -20e3, 8e3])
    boresight = np.array([1.0, 0.0, 0.0])
    line = np.array([1.0, 0.03, 0.02])
    line /= np.linalg.norm(line)
    # Such an attitude maps the geometric boresight to its apparent direction.
    apparent = aberrate(np.stack([boresight, line]), orbital + solar)[0]
    turn = Rotation.from_rotvec(np.cross(boresight, apparent))
    target_seen = aberrate(line[None], orbital)[0]
    measured = turn.inv().apply(target_seen)
    assert np.linalg.norm(measured - line) > 10 * ARCSEC
    found = without_aberration(measured, orbital, boresight=boresight,
                               stars_velocity_m_s=orbital + solar)
    assert np.linalg.norm(found - line) < 1e-3 * ARCSEC
    np.testing.assert_allclose(without_aberration(target_seen, orbital), line, atol=1e-15)
