# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude against SciPy, against its own covariance, and what it rejects."""

from directions import blurred, field, unit
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from startracker_ros.core.attitude.estimate import (
    AttitudeError, covariance_icrf, cramer_rao, estimate_attitude, SOLVERS)
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, matrix_from_quaternion, quaternion_from_pointing, rotate)

POINTING = quaternion_from_pointing(*np.radians([251.3, -37.2, 118.0]))


@given(arrays(float, 4, elements=st.floats(-1, 1)), st.integers(3, 30), st.integers(0, 9999))
def test_agrees_with_scipy(q, count, seed):
    rng = np.random.default_rng(seed)
    q = unit(q) if np.linalg.norm(q) > 1e-3 else POINTING
    sigma_rad = rng.uniform(5, 50, count) * ARCSEC
    true = field(rng, count, rng.uniform(0.05, 0.6))
    icrf, sensor = rotate(q, true), blurred(true, sigma_rad, rng)
    expected = Rotation.align_vectors(icrf, sensor, weights=1 / sigma_rad ** 2)[0].as_quat()
    for sign in (1, -1):
        # The two quaternions of one rotation must give the same result.
        estimate = estimate_attitude(sensor, rotate(sign * q, true), sigma_rad)
        assert estimate.stars == count and estimate.quaternion[3] >= 0
        assert np.linalg.norm(attitude_error(estimate.quaternion, expected)) < 1e-9
    cosine = np.sum(rotate(estimate.quaternion, sensor) * icrf, -1)
    np.testing.assert_allclose(np.cos(estimate.residual_rad), cosine, atol=1e-14)


@given(arrays(float, 4, elements=st.floats(-1, 1)), st.integers(2, 20))
def test_exact_directions_give_the_exact_attitude(q, count):
    q = unit(q) if np.linalg.norm(q) > 1e-3 else -POINTING
    sensor = field(np.random.default_rng(count), count)
    estimate = estimate_attitude(3 * sensor, 5 * rotate(q, sensor), np.full(count, 1e-5))
    assert np.linalg.norm(attitude_error(estimate.quaternion, q)) < 1e-12
    assert estimate.chi2 < 1e-12


def test_covariance_and_chi2_are_consistent():
    rng = np.random.default_rng(1)
    true = field(rng, 12)
    sigma_rad = np.geomspace(2, 30, 12) * ARCSEC
    icrf, trials = rotate(POINTING, true), 2000
    nees, fit, errors = [], [], []
    for _ in range(trials):
        estimate = estimate_attitude(blurred(true, sigma_rad, rng), icrf, sigma_rad)
        error = attitude_error(estimate.quaternion, POINTING)
        nees.append(error @ np.linalg.solve(estimate.covariance_sensor, error))
        fit.append(estimate.chi2)
        errors.append(error)
    bounds = np.array(chi2.ppf([0.001, 0.999], 3 * trials)) / trials
    assert bounds[0] < np.mean(nees) < bounds[1]
    bounds = np.array(chi2.ppf([0.001, 0.999], (2 * 12 - 3) * trials)) / trials
    assert bounds[0] < np.mean(fit) < bounds[1]
    # No estimator is better than the bound: the variance reaches it on every axis.
    ratio = np.var(errors, axis=0) / np.diag(cramer_rao(true, sigma_rad))
    np.testing.assert_allclose(ratio, 1, atol=0.12)
    # On ICRF axes the same error has the turned covariance.
    turned = covariance_icrf(POINTING, estimate.covariance_sensor)
    error_icrf = matrix_from_quaternion(POINTING) @ error
    np.testing.assert_allclose(error_icrf @ np.linalg.solve(turned, error_icrf),
                               error @ np.linalg.solve(estimate.covariance_sensor, error))


@pytest.mark.parametrize('separation_rad', [0.1, 1e-2, 1e-3])
def test_two_close_stars_admit_that_roll_is_unknown(separation_rad):
    rng = np.random.default_rng(2)
    sigma_rad = np.full(2, 10 * ARCSEC)
    true = unit(np.array([[separation_rad / 2, 0, 1], [-separation_rad / 2, 0, 1]]))
    errors = np.array([attitude_error(estimate_attitude(
        blurred(true, sigma_rad, rng), rotate(POINTING, true), sigma_rad).quaternion,
        POINTING) for _ in range(400)])
    sigma = np.sqrt(np.diag(cramer_rao(true, sigma_rad)))
    assert sigma[2] == pytest.approx(np.sqrt(2) * sigma_rad[0] / separation_rad, rel=0.01)
    np.testing.assert_allclose(np.std(errors, axis=0) / sigma, 1, atol=0.12)


@given(st.integers(4, 25))
@settings(max_examples=20)
def test_mirrored_stars_do_not_fit(count):
    rng = np.random.default_rng(count)
    sensor = field(rng, count)
    mirrored = rotate(POINTING, sensor) * [1, 1, -1]
    estimate = estimate_attitude(sensor, mirrored, np.full(count, 10 * ARCSEC))
    assert estimate.chi2 > 1000 * (2 * count - 3)


def test_one_wrong_star_shows_in_its_residual():
    sensor = field(np.random.default_rng(3), 10)
    icrf = rotate(POINTING, sensor)
    icrf[4] = icrf[5]
    estimate = estimate_attitude(sensor, icrf, np.full(10, 10 * ARCSEC))
    assert np.argmax(estimate.residual_rad) == 4 and estimate.chi2 > 1e4


@pytest.mark.parametrize('change, text', [
    (lambda s, i, e: (s[:1], i[:1], e[:1]), '1 stars'),
    (lambda s, i, e: (s[:0], i[:0], e[:0]), '0 stars'),
    (lambda s, i, e: (s[:4], i, e), 'shapes'),
    (lambda s, i, e: (s * np.nan, i, e), 'NaN'),
    (lambda s, i, e: (s, i * np.inf, e), 'NaN'),
    (lambda s, i, e: (s, i, e * np.nan), 'NaN'),
    (lambda s, i, e: (s, i, e * 0), 'sigma'),
    (lambda s, i, e: (s, i, -e), 'sigma'),
    (lambda s, i, e: (s * 0, i, e), 'length zero'),
    (lambda s, i, e: (s[[0, 0, 0]], i[[0, 0, 0]], e[:3]), 'directions 0 and 1 are identical'),
    (lambda s, i, e: (s[[3, 3]], i[[3, 3]], e[:2]), 'directions 0 and 1 are identical'),
    (lambda s, i, e: (s[[0, 1, 2, 3, 1]], i[[0, 1, 2, 3, 1]], e), 'directions 1 and 4'),
    (lambda s, i, e: (s[[0, 0, 0]] * [[1], [2], [3]], i[[0, 0, 0]], e[:3]), 'parallel'),
    (lambda s, i, e: (s[[0, 0]] * [[1], [-1]], i[[0, 0]] * [[1], [-1]], e[:2]), 'parallel'),
    (lambda s, i, e: (s[[0, 1]], i[[0, 0]], e[:2]), 'parallel'),
    (lambda s, i, e: (s, i, e[:, None]), 'shapes'),
    (lambda s, i, e: (s, i, 1e-4), 'shapes'),
])
@pytest.mark.parametrize('solver', SOLVERS)
def test_rejects_what_has_no_attitude(change, text, solver):
    sensor = field(np.random.default_rng(4), 5)
    with pytest.raises(AttitudeError, match=text):
        estimate_attitude(*change(sensor, rotate(POINTING, sensor), np.full(5, 1e-4)), solver)


def test_rejects_an_unknown_solver():
    sensor = field(np.random.default_rng(4), 5)
    with pytest.raises(ValueError, match="no solver 'esoq'; there are quest, davenport"):
        estimate_attitude(sensor, sensor, np.full(5, 1e-4), 'esoq')


def test_takes_any_array_and_leaves_it_as_it_is():
    sensor = field(np.random.default_rng(5), 5)
    icrf, sigma_rad = rotate(POINTING, sensor), np.full(5, 1e-4)
    expected = estimate_attitude(sensor, icrf, sigma_rad)
    turned = np.asfortranarray(2e200 * sensor)
    turned.flags.writeable = False
    before = turned.copy()
    for directions in (turned, np.repeat(sensor, 2, 0)[::2], sensor.tolist(), 1e-200 * sensor):
        found = estimate_attitude(directions, icrf, sigma_rad)
        np.testing.assert_allclose(found.quaternion, expected.quaternion, atol=1e-14)
    np.testing.assert_array_equal(turned, before)


def test_bound_of_parallel_directions_is_rejected():
    with pytest.raises(AttitudeError, match='parallel'):
        cramer_rao(np.array([[0.0, 0, 1], [0, 0, 1]]), np.full(2, 1e-4))
