# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The four solvers: the same attitude, each its own covariance, close stars."""

from itertools import permutations

from directions import blurred, unit
from hypothesis import given, settings, strategies as st
from native_integrity import best_rotation
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from startracker_ros.core.attitude.estimate import (
    AttitudeError, cramer_rao, estimate_attitude, mean_chi2, SOLVERS)
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_matrix, rotate)

OPTIMAL = [name for name in SOLVERS if name != 'triad']
HALF_TURNS = [np.array(q, float) for q in (
    [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.6, 0.8, 0, 0], [0.48, 0.6, 0.64, 0])]
ROTATIONS = st.one_of(
    st.sampled_from(HALF_TURNS),
    st.integers(0, 9999).map(lambda seed: Rotation.random(
        random_state=np.random.default_rng(seed)).as_quat()),
    # A little off a half turn.
    st.tuples(st.sampled_from(HALF_TURNS), st.floats(1e-9, 1e-3)).map(
        lambda pair: multiply(pair[0], Rotation.from_rotvec(
            pair[1] * np.array([0.6, 0.48, 0.64])).as_quat())))


def field(rng, count, half_angle_rad=0.1):
    """Return directions (N, 3) in a square field, two of them at its corners."""
    tangent = rng.uniform(-1, 1, (count, 2))
    tangent[:2] = [[-1, -1], [1, 1]]
    return unit(np.concatenate([tangent * np.tan(half_angle_rad), np.ones((count, 1))], -1))


def pair(separation_rad):
    """Return two directions (2, 3) on both sides of the boresight."""
    half = separation_rad / 2
    return np.array([[np.sin(half), 0, np.cos(half)], [-np.sin(half), 0, np.cos(half)]])


def monte_carlo(solver, true, sigma_rad, q, runs, rng):
    """Return NEES (T,), errors (T, 3), chi2 (T,) and the last estimate."""
    icrf, nees, found, fit = rotate(q, true), [], [], []
    for _ in range(runs):
        estimate = estimate_attitude(blurred(true, sigma_rad, rng), icrf, sigma_rad, solver)
        error = attitude_error(estimate.quaternion, q)
        nees.append(error @ np.linalg.solve(estimate.covariance_sensor, error))
        found.append(error)
        fit.append(estimate.chi2)
    return np.array(nees), np.array(found), np.array(fit), estimate


@given(ROTATIONS, st.integers(2, 30), st.floats(0.03, 1.4), st.integers(0, 9999))
def test_all_agree_on_exact_directions(q, count, half_angle_rad, seed):
    rng = np.random.default_rng(seed)
    true = field(rng, count, half_angle_rad)
    sigma_rad = rng.uniform(1, 20, count) * ARCSEC
    for solver in SOLVERS:
        estimate = estimate_attitude(true, rotate(q, true), sigma_rad, solver)
        assert np.linalg.norm(attitude_error(estimate.quaternion, q)) < 1e-10, solver
        assert estimate.quaternion[3] >= 0 and estimate.chi2 < 1e-9


@given(ROTATIONS, st.integers(2, 30), st.floats(0.03, 1.4), st.integers(0, 9999))
def test_the_optimal_ones_agree_on_noisy_directions(q, count, half_angle_rad, seed):
    rng = np.random.default_rng(seed)
    true = field(rng, count, half_angle_rad)
    sigma_rad = rng.uniform(1, 20, count) * ARCSEC
    sensor, icrf = blurred(true, sigma_rad, rng), rotate(q, true)
    expected = estimate_attitude(sensor, icrf, sigma_rad, OPTIMAL[0])
    for solver in OPTIMAL[1:]:
        estimate = estimate_attitude(sensor, icrf, sigma_rad, solver)
        assert np.linalg.norm(attitude_error(estimate.quaternion, expected.quaternion)) < 1e-10
        np.testing.assert_allclose(estimate.covariance_sensor, expected.covariance_sensor,
                                   rtol=1e-6, atol=1e-9 * expected.covariance_sensor.max())
        np.testing.assert_allclose(estimate.residual_rad, expected.residual_rad, atol=1e-10)


@pytest.mark.slow
@given(st.integers(2, 8), st.booleans(), st.integers(0, 9999))
@settings(max_examples=300)
def test_the_optimal_ones_agree_on_directions_that_do_not_fit(count, narrow, seed):
    """The two stars that QUEST starts from contradict the others here, by any angle."""
    rng = np.random.default_rng(seed)
    sensor, icrf = rng.normal(0, 1, (2, count, 3))
    if narrow:
        sensor, icrf = sensor * [0.1, 0.1, 0] + [0, 0, 1], icrf * [0.1, 0.1, 0] + [0, 0, 1]
    sigma_rad = 10 ** rng.uniform(-5, -4, count)
    weight = sigma_rad ** -2 / np.sum(sigma_rad ** -2)
    matrix, gap = best_rotation('davenport', unit(sensor), unit(icrf), weight, sigma_rad)
    q = quaternion_from_matrix(matrix)
    for solver in ('quest', 'svd'):
        estimate = estimate_attitude(sensor, icrf, sigma_rad, solver)
        assert np.linalg.norm(attitude_error(estimate.quaternion, q)) * gap < 1e-13


@pytest.mark.parametrize('seed', range(5))
def test_quest_does_not_depend_on_the_two_stars_it_starts_from(seed):
    """The two best ones exchanged: their attitude is half a turn from that of all others."""
    rng = np.random.default_rng(seed)
    true = field(rng, 40)
    sigma_rad = np.where(np.arange(40) < 2, 0.9, 1) * 5 * ARCSEC
    icrf = rotate(HALF_TURNS[4], true)
    icrf[:2] = icrf[1::-1]
    alone = estimate_attitude(true[:2], icrf[:2], sigma_rad[:2])
    estimate = estimate_attitude(true, icrf, sigma_rad)
    between = attitude_error(alone.quaternion, estimate.quaternion)
    assert np.linalg.norm(between) > np.radians(170)
    expected = estimate_attitude(true, icrf, sigma_rad, 'davenport')
    assert np.linalg.norm(attitude_error(estimate.quaternion, expected.quaternion)) < 1e-10


@pytest.mark.parametrize('seed', range(5))
def test_triad_takes_the_two_stars_of_the_least_covariance(seed):
    rng = np.random.default_rng(seed)
    true, sigma_rad = field(rng, 6), rng.uniform(1, 20, 6) * ARCSEC
    icrf = rotate(HALF_TURNS[4], true)
    sensor = blurred(true, sigma_rad, rng)
    found = estimate_attitude(sensor, icrf, sigma_rad, 'triad')
    each = [estimate_attitude(sensor[list(two)], icrf[list(two)], sigma_rad[list(two)], 'triad')
            for two in permutations(range(6), 2)]
    best = min(each, key=lambda estimate: np.trace(estimate.covariance_sensor))
    np.testing.assert_allclose(found.quaternion, best.quaternion, atol=1e-12)
    np.testing.assert_allclose(found.covariance_sensor, best.covariance_sensor, rtol=1e-9)
    # The more accurate one of the two is met exactly.
    assert found.residual_rad.min() < 1e-12
    # No unbiased attitude is better than the bound: what is left over has no negative part.
    more = found.covariance_sensor - cramer_rao(true, sigma_rad)
    assert np.linalg.eigvalsh(more).min() > -1e-3 * np.trace(more)


@pytest.mark.slow
@pytest.mark.parametrize('solver', SOLVERS)
def test_each_covariance_is_true(solver):
    rng = np.random.default_rng(11)
    every = []
    for count, half_angle_rad in ((2, 0.1), (2, 0.7), (5, 0.1), (15, 0.1)):
        true = field(rng, count, half_angle_rad)
        sigma_rad = rng.uniform(2, 30, count) * ARCSEC
        q, runs = Rotation.random(random_state=rng).as_quat(), 500
        nees, errors, fit, last = monte_carlo(solver, true, sigma_rad, q, runs, rng)
        every.append(nees)
        # Each principal axis by itself.
        variance, axes = np.linalg.eigh(last.covariance_sensor)
        low, high = chi2.ppf([0.0005, 0.9995], runs) / runs
        ratio = np.mean((errors @ axes) ** 2, 0) / variance
        assert (low < ratio).all() and (ratio < high).all()
        mean = mean_chi2(last, rotate(q, true), sigma_rad)
        assert solver == 'triad' or mean == pytest.approx(2 * count - 3, rel=1e-6)
        assert abs(fit.mean() - mean) < 3.5 * fit.std() / np.sqrt(runs)
    nees = np.concatenate(every)
    low, high = chi2.ppf([0.025, 0.975], 3 * len(nees)) / len(nees)
    assert low < nees.mean() < high


@pytest.mark.parametrize('solver', SOLVERS)
@pytest.mark.parametrize('separation_rad', [np.pi / 2, 0.1, 1e-2, 1e-3, 100 * ARCSEC, 5 * ARCSEC])
def test_two_stars_have_a_true_covariance(solver, separation_rad):
    rng = np.random.default_rng(3)
    # Stars closer than their error have no roll that a covariance could describe.
    sigma_rad = np.array([1.0, 2.0]) * min(20 * ARCSEC, separation_rad / 100)
    nees, *_ = monte_carlo(solver, pair(separation_rad), sigma_rad, HALF_TURNS[3], 400, rng)
    low, high = chi2.ppf([0.0005, 0.9995], 3 * 400) / 400
    assert low < nees.mean() < high


@pytest.mark.parametrize('solver', SOLVERS)
def test_the_covariance_of_close_stars_grows_without_a_jump(solver):
    separations = np.geomspace(np.pi / 2, ARCSEC, 60)
    sigma_rad = np.full(2, 5 * ARCSEC)
    worst = []
    for separation_rad in separations:
        true = pair(separation_rad)
        estimate = estimate_attitude(true, rotate(HALF_TURNS[4], true), sigma_rad, solver)
        assert np.linalg.norm(attitude_error(estimate.quaternion, HALF_TURNS[4])) < 1e-4
        worst.append(np.sqrt(np.linalg.eigvalsh(estimate.covariance_sensor)[2]))
    growth = np.diff(np.log(worst)) / -np.diff(np.log(separations))
    assert (growth > 0).all() and (growth < 1.001).all()
    assert worst[-1] == pytest.approx(np.sqrt(2) * sigma_rad[0] / separations[-1], rel=1e-3)


@pytest.mark.parametrize('solver', SOLVERS)
def test_the_attitude_of_close_stars_moves_with_them(solver):
    separation_rad = 10 * ARCSEC
    true = pair(separation_rad)
    icrf, sigma_rad = rotate(HALF_TURNS[4], true), np.full(2, ARCSEC)
    before = HALF_TURNS[4]
    for step in np.linspace(0, 1, 101)[1:]:
        # One star goes half around the other.
        sensor = true.copy()
        angle = np.pi / 2 * step
        sensor[0] = unit(true[1] + separation_rad * np.array([np.cos(angle), np.sin(angle), 0]))
        estimate = estimate_attitude(sensor, icrf, sigma_rad, solver)
        turned = attitude_error(estimate.quaternion, before)
        assert np.abs(turned[2]) == pytest.approx(np.pi / 200, rel=1e-3)
        assert np.hypot(*turned[:2]) < separation_rad
        before = estimate.quaternion


@pytest.mark.parametrize('solver', SOLVERS)
def test_the_covariance_is_that_of_the_catalogue(solver):
    """Close stars that noise has brought still closer are not less accurate for that."""
    true = pair(20 * ARCSEC)
    sigma_rad = np.full(2, 5 * ARCSEC)
    expected = estimate_attitude(true, true, sigma_rad, solver).covariance_sensor
    for separation in (2, 10, 40):
        estimate = estimate_attitude(pair(separation * ARCSEC), true, sigma_rad, solver)
        np.testing.assert_allclose(np.linalg.eigvalsh(estimate.covariance_sensor),
                                   np.linalg.eigvalsh(expected), rtol=1e-3)


@pytest.mark.parametrize('solver', SOLVERS)
def test_stars_that_double_precision_cannot_resolve_are_rejected(solver):
    with pytest.raises(AttitudeError, match='parallel'):
        estimate_attitude(pair(0.1 * ARCSEC), pair(0.1 * ARCSEC), np.full(2, ARCSEC), solver)
    # Nor does one accurate star next to a very inaccurate one have a roll.
    if solver != 'triad':
        with pytest.raises(AttitudeError, match='unevenly'):
            estimate_attitude(pair(0.1), pair(0.1), np.array([1e-6, 10.0]), solver)
