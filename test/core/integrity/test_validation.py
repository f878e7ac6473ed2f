# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Validation of attitudes before they are published."""

from dataclasses import replace

import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core.attitude.estimate import estimate_attitude, SOLVERS
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.integrity.validation import AttitudeValidator, ValidationOptions
from startracker_ros.core.maths.rotation import (
    attitude_error, matrix_from_quaternion, quaternion_from_pointing)
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

ONBOARD = onboard_stars(CAMERA, 2026.0, 6.0)
POINTING = quaternion_from_pointing(*np.radians([83.0, -1.0, 20.0]))
SKY = ApparentCatalog(ONBOARD)


@pytest.fixture
def stars():
    """Return positions (N, 2) px, numbers (N,) and covariances (N, 2, 2) px^2 of a field."""
    centroids, hip = star_list(ONBOARD, CAMERA, POINTING, 0.1, np.random.default_rng(1))
    return centroids.uv, hip, centroids.covariance


def validator(**options):
    return AttitudeValidator(CAMERA, replace(ValidationOptions(), **options))


def covariance(solver, *stars):
    return validator(solver=solver).solve(SKY, *stars).attitude.covariance_sensor


@pytest.mark.parametrize('solver', SOLVERS)
def test_the_solver_is_the_one_of_the_options(stars, solver):
    uv, hip, error_px2 = stars
    found = validator(solver=solver).solve(SKY, *stars).attitude
    expected = estimate_attitude(
        CAMERA.unproject(uv), ONBOARD.direction[ONBOARD.index_of(hip)],
        np.sqrt(error_px2[:, 0, 0]) * CAMERA.pixel_rad, solver)
    assert np.linalg.norm(attitude_error(found.quaternion, expected.quaternion)) < 1e-14
    scale = found.covariance_sensor / expected.covariance_sensor
    assert scale == pytest.approx(scale[0, 0]) and scale[0, 0] >= 1


@pytest.mark.parametrize('solver', SOLVERS)
def test_residuals_larger_than_promised_scale_the_covariance(stars, solver):
    uv, hip, error_px2 = stars
    promised = covariance(solver, uv, hip, error_px2)
    scaled = covariance(solver, uv, hip, error_px2 / 100)
    # The same residuals: the covariance follows them, within their scatter.
    assert np.trace(scaled) / np.trace(promised) == pytest.approx(1, abs=0.5)
    larger = covariance(solver, uv, hip, 100 * error_px2)
    assert np.trace(larger) > 50 * np.trace(promised)


def test_errors_that_are_not_round_weigh_each_axis():
    """Streaks of one direction: along them sigma is 1 px, across 0.05 px."""
    rng, along = np.random.default_rng(3), np.array([np.cos(0.5), np.sin(0.5)])
    error = np.outer(along, along) + 0.05 ** 2 * (np.eye(2) - np.outer(along, along))
    rounded = np.eye(2) * np.trace(error) / 2
    uv, hip, _ = _field(POINTING)
    exact = CAMERA.project(
        ONBOARD.direction[ONBOARD.index_of(hip)] @ matrix_from_quaternion(POINTING))
    errors, nees = [], []
    for _ in range(200):
        noisy = exact + rng.multivariate_normal(np.zeros(2), error, len(uv))
        for covariance in (error, rounded):
            solved = validator(max_residual_px=5.0).solve(
                SKY, noisy, hip, np.tile(covariance, (len(uv), 1, 1))).attitude
            errors.append(attitude_error(solved.quaternion, POINTING))
            nees.append(errors[-1] @ np.linalg.solve(solved.covariance_sensor, errors[-1]))
    with_ellipses, with_circles = np.sqrt(np.mean(np.square(
        np.array(errors).reshape(-1, 2, 3)), axis=0))
    assert with_ellipses[2] < 0.3 * with_circles[2]
    low, high = mean_chi_square_bounds(3, len(nees[::2]))
    assert low < np.mean(nees[::2]) < high, (low, np.mean(nees[::2]), high)


def test_rejections_have_a_reason(stars):
    uv, hip, error_px2 = stars
    few = validator().solve(SKY, uv[:3], hip[:3], error_px2[:3])
    assert few.attitude is None and few.reason == '3 identified stars, min_stars is 4'
    unknown = validator().solve(SKY, uv, np.zeros_like(hip), error_px2)
    assert unknown.attitude is None and unknown.reason.startswith('0 identified stars')
    wrong = validator().solve(SKY, uv, np.roll(hip, 1), error_px2)
    assert wrong.attitude is None and 'above max_residual_px = 1' in wrong.reason
    twice = validator().solve(SKY, uv[[0, 1, 2, 2]], hip[[0, 1, 2, 2]], error_px2[:4])
    assert twice.attitude is None and 'identical: one star counted twice' in twice.reason


@pytest.mark.parametrize('element, value', [
    ((0, 0), -1e-12), ((2, 2), 0.0), ((0, 1), 1.0), ((1, 1), np.nan), ((0, 0), np.inf)])
def test_an_attitude_of_a_covariance_that_is_none_is_not_published(stars, element, value):
    uv, hip, error_px2 = stars
    solved = validator().solve(SKY, uv, hip, error_px2).attitude
    sigma_px = np.sqrt(error_px2[:, 0, 0])

    def checked(covariance):
        return validator().check(
            SKY, replace(solved, covariance_sensor=covariance), uv, hip, sigma_px, sigma_px)
    assert checked(solved.covariance_sensor).attitude is not None
    bad = solved.covariance_sensor.copy()
    bad[element] = bad[element[::-1]] = value
    found = checked(bad)
    assert found.attitude is None and 'not positive definite' in found.reason
    assert np.isinf(found.protection_rad).all()


def test_the_sign_of_the_quaternion_is_continuous():
    continuous, signs = validator(), []
    for roll_deg in np.arange(0, 720, 20):
        q = quaternion_from_pointing(*np.radians([83.0, -1.0, roll_deg]))
        uv, hip, error_px2 = _field(q)
        signs.append(continuous.solve(SKY, uv, hip, error_px2).attitude.quaternion)
    assert (np.sum(np.array(signs[1:]) * signs[:-1], 1) > 0.9).all()
    assert min(q[3] for q in signs) < -0.5


def _field(q):
    centroids, hip = star_list(ONBOARD, CAMERA, q, 0.1, np.random.default_rng(2))
    return centroids.uv, hip, centroids.covariance
