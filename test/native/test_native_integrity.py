# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Solvers and checks of the native core give what those in Python gave: integrity.npz; and oracles.

What is found is equal, sentence by sentence. Numbers agree to rounding errors, which sums in
another order and inverses by other formulas have.
"""

from functools import cache, partial
import math

from native_core import call, filled
import native_integrity
from native_integrity import (
    best_rotation, camera_struct, checks, compare_gyro, contradiction, covariance_inputs,
    cramer_rao, directions, EXPECTED_FAULTS, find_pattern, fit_error_ellipses, fit_rows,
    GYRO_OPTIONS, mean_chi2, PARALLEL, PROBABILITIES, protection_level, RECORD, refine,
    ROW_FAULTS, RUNS, sentence, solve, solver_inputs, SOLVERS, spans, STAMP_FAULTS, triad,
    trust_options, trust_stars, trust_tracks, TRUSTED, with_row_fault, with_stamp_errors,
    with_stars_elsewhere)
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, ndtri
from scipy.stats import chi2
from startracker_ros.core import native
from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude, failure
from startracker_ros.core.integrity.checks import CHECKS

EXACT, CLOSE = 1e-12, 1e-9
OPTIMAL = SOLVERS[:3]


@cache
def record() -> dict[str, np.ndarray]:
    with np.load(RECORD) as archive:
        return dict(archive)


@cache
def of_run(name: str) -> dict[str, np.ndarray]:
    """Return the arrays of a run by their names; camera as an st_camera."""
    found = {key.removeprefix(f'{name}/'): value for key, value in record().items()
             if key.startswith(f'{name}/')}
    found['camera'] = np.frombuffer(found['camera'].tobytes(), native.CAMERA).reshape(())
    return found


def runs_with(key: str) -> list[str]:
    """Return the runs whose record has a key."""
    return [name for name in RUNS if f'{name}/{key}' in record()]


def close(found, expected, relative, scale=0.0):
    """Compare arrays, to a share of the expected one or of a scale."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    assert found.shape == expected.shape
    limit = relative * np.maximum(np.abs(expected), scale)
    equal = (found == expected) | (np.isnan(found) & np.isnan(expected))
    away = np.abs(np.where(equal, 0.0, found) - np.where(equal, 0.0, expected))
    assert (away <= limit).all(), np.max(away / np.maximum(limit, 1e-300))


def close_covariance(found, expected, relative):
    """Compare covariances (..., 3, 3) to a share of the sigmas of their axes."""
    sigma = np.sqrt(np.abs(np.einsum('...ii->...i', expected)))
    close(found, expected, relative, sigma[..., :, None] * sigma[..., None, :])


def turn_between(q, other):
    return np.linalg.norm((Rotation.from_quat(q).inv() * Rotation.from_quat(other)).as_rotvec())


# --- the table ---


def test_both_languages_have_the_same_checks_in_one_order():
    assert list(checks()) == list(CHECKS) == [one.name for one in CHECKS.values()]
    assert list(checks()) == list(native.checks())


@pytest.mark.parametrize('name', CHECKS)
def test_a_threshold_is_the_chi_square_of_its_probability(name):
    check = checks()[name]
    if not check['dof']:
        assert check['threshold'] == 0
        return
    assert check['threshold'] == pytest.approx(
        chdtri(check['dof'], check['probability']), rel=1e-11)
    assert call('stt_gate', check['probability'], float(check['dof'])) == pytest.approx(
        check['threshold'], rel=1e-13)


@pytest.mark.parametrize('probability', [1e-80, 1e-30, 1e-12, 1e-5, 1e-3, 0.05, 0.3])
@pytest.mark.parametrize('dof', [1.0, 2.0, 3.0, 6.0, 17.4, 77.0])
def test_a_gate_is_that_of_scipy(probability, dof):
    found = call('stt_gate', probability, dof)
    assert found == pytest.approx(chdtri(dof, probability), rel=1e-11)


@pytest.mark.parametrize('probability', [1e-300, 1e-30, 1e-12, 3.3e-8, 1e-3, 0.1, 0.5, 0.9, 1.0])
def test_sigmas_of_a_normal_value_are_those_of_scipy(probability):
    assert call('stt_two_sided_sigmas', probability) == pytest.approx(
        -ndtri(probability / 2), rel=1e-14, abs=1e-15)


def test_a_restart_is_told_from_a_late_frame_by_one_figure():
    assert CHECKS['LATE_FRAME'].limits['back_s'] * 1e9 == RESTART_NS


def test_reasons_have_the_sentences_of_their_checks():
    assert sentence(CHECKS['FEW_STARS'].reason, [3.0, 4.0, 1.0]) == (
        '3 tracked stars, min_stars is 4')
    rates = [*np.radians([1, 2, 3.0]), 0, 0, 0.5]
    assert sentence(CHECKS['GYRO_DIFFERS'].reason, rates).startswith(
        'imu reports 1.0000 2.0000 3.0000 deg/s about x, y, z, the stars 0.0000 0.0000 28.6479:')
    assert '[1.0, nan, -2.0] rad^2' in sentence(CHECKS['COVARIANCE'].reason, [1.0, np.nan, -2.0])
    assert sentence(CHECKS['BAD_FRAMES'].reason, [5.0, 2.0, 0.456]) == (
        '5 bad frames: 2 stars agreed in the last one, residual 0.46 px')


# --- solvers ---

STATUS = (0, 606, 607, 608, 609, 610)  # reasons of the status of the solvers in Python
INPUTS = solver_inputs()


def unit(vectors):
    scaled = vectors / np.abs(vectors).max(axis=1, keepdims=True)
    return scaled / np.linalg.norm(scaled, axis=1, keepdims=True)


def weights(sigma):
    """Return the weights (N,), of sum 1, and the errors."""
    weight = sigma ** -2.0
    return weight / weight.sum(), sigma


@pytest.mark.parametrize('solver', SOLVERS)
@pytest.mark.parametrize('name', INPUTS)
def test_a_solution_or_its_failure_is_that_of_the_record(name, solver):
    sensor, icrf, sigma = INPUTS[name]
    expected = record()['solutions'][4 * list(INPUTS).index(name) + SOLVERS.index(solver)]
    found = solve(solver, sensor, icrf, sigma)
    assert found.code == STATUS[int(expected[0])]
    if found.code:
        with pytest.raises(AttitudeError) as error:
            estimate_attitude(sensor, icrf, sigma, solver)
        assert str(error.value) == failure(found.code, found.figures)
        return
    # Eigenvectors hold their digits but for rounding errors over the gap to the next one.
    _, gap = best_rotation('svd', unit(sensor), unit(icrf), *weights(sigma))
    rounding = 2e-15 / gap if solver in ('davenport', 'svd') else 1e-14 / np.sqrt(gap)
    assert turn_between(found.quaternion, expected[3:7]) < 1e-15 + rounding
    covariance = expected[7:16].reshape(3, 3)
    assert found.quaternion[3] >= 0
    close_covariance(found.covariance, covariance, CLOSE)
    close([found.chi2, found.residual_rad.max()], expected[16:], CLOSE, [1.0, 1e-6])


@pytest.mark.parametrize('solver', OPTIMAL)
@pytest.mark.parametrize('count', [2, 3, 8, 40])
def test_the_best_fit_is_that_of_scipy(count, solver):
    rng = np.random.default_rng(count)
    for _ in range(20):
        sensor, icrf, sigma = directions(rng, count)
        expected, _ = Rotation.align_vectors(icrf, sensor, weights=(sigma.min() / sigma) ** 2)
        assert turn_between(solve(solver, sensor, icrf, sigma).quaternion,
                            expected.as_quat()) < 1e-11


def test_the_gap_of_davenport_and_svd_is_one_and_that_of_quest_no_larger():
    rng = np.random.default_rng(2)
    for sensor, icrf in rng.normal(size=(50, 2, 5, 3)):
        sensor, icrf = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (sensor, icrf))
        weight, sigma = np.full(5, 0.2), np.full(5, 1e-4)
        matrices, gaps = zip(*(best_rotation(one, sensor, icrf, weight, sigma)
                               for one in OPTIMAL))
        assert gaps[1] == pytest.approx(gaps[2], rel=1e-12, abs=1e-15)
        assert gaps[0] <= gaps[1] * (1 + 1e-12)
        for matrix in matrices:
            close(matrix @ matrix.T, np.eye(3), 1e-14, 1.0)
            assert np.linalg.det(matrix) == pytest.approx(1)


@pytest.mark.parametrize('count', [3, 5, 20])
def test_refinement_ends_at_the_best_fit_with_its_covariance(count):
    rng = np.random.default_rng(count)
    sensor, icrf, sigma = directions(rng, count)
    expected = solve('davenport', sensor, icrf, sigma)
    matrix, covariance, determinant = refine(
        triad(sensor, icrf, 0, count - 1), sensor, icrf, 1 / sigma ** 2)
    assert determinant > 0
    assert turn_between(Rotation.from_matrix(matrix).as_quat(), expected.quaternion) < 1e-11
    close_covariance(covariance, expected.covariance, 1e-9)
    F = sum(w * (np.eye(3) - np.outer(p, p)) for w, p in zip(1 / sigma ** 2, sensor))
    close_covariance(cramer_rao(sensor, sigma), np.linalg.inv(F), 1e-9)
    assert mean_chi2(expected, icrf, sigma) == pytest.approx(2 * count - 3, rel=1e-9)


def test_parallel_directions_are_not_refined():
    sensor = np.tile([0.0, 0.0, 1.0], (3, 1))
    assert refine(np.eye(3), sensor, sensor, np.ones(3))[2] == 0
    assert solve('quest', sensor * [[1], [2], [3]], sensor, np.ones(3)).code == PARALLEL


def test_two_stars_alone_meet_the_first_exactly():
    sensor, icrf, sigma = directions(np.random.default_rng(1), 4, noise=1e-3)
    matrix = triad(sensor, icrf, 2, 0)
    close(matrix @ sensor[2], icrf[2], 1e-14, 1.0)
    found = solve('triad', sensor, icrf, sigma)
    assert found.residual_rad.min() < 1e-12


@pytest.mark.parametrize('solver', SOLVERS)
@pytest.mark.parametrize('count, half_width', [(2, 0.1), (2, 0.7), (5, 0.1), (15, 0.1)])
def test_errors_are_those_of_the_covariance(count, half_width, solver):
    rng, runs = np.random.default_rng(11), 400
    true, icrf, sigma = directions(rng, count, half_width, noise=1e-9)
    sigma = sigma * 1e5
    q = solve('svd', true, icrf, sigma).quaternion
    nees = []
    for _ in range(runs):
        noisy = true + rng.normal(size=true.shape) * sigma[:, None]
        found = solve(solver, noisy, icrf, sigma)
        error = (Rotation.from_quat(q).inv() * Rotation.from_quat(found.quaternion)).as_rotvec()
        nees.append(error @ np.linalg.solve(found.covariance, error))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * runs) / runs
    assert low < np.mean(nees) < high


@pytest.mark.parametrize('solver', SOLVERS)
def test_the_covariance_of_close_stars_grows_without_a_jump(solver):
    separations = np.geomspace(np.pi / 2, 5e-6, 60)
    sigma, worst = np.full(2, 2.5e-5), []
    for half in separations / 2:
        true = np.array([[np.sin(half), 0, np.cos(half)], [-np.sin(half), 0, np.cos(half)]])
        found = solve(solver, true, true @ np.diag([1.0, -1.0, -1.0]), sigma)
        worst.append(np.sqrt(np.linalg.eigvalsh(found.covariance)[2]))
    growth = np.diff(np.log(worst)) / -np.diff(np.log(separations))
    assert (growth > 0).all() and (growth < 1.001).all()
    assert worst[-1] == pytest.approx(np.sqrt(2) * sigma[0] / separations[-1], rel=1e-3)


def test_errors_that_are_not_round_are_fitted_by_least_squares():
    rng = np.random.default_rng(8)
    one = covariance_inputs()[0]
    camera, model = camera_struct(one.camera), one.camera
    uv = rng.uniform(20, 740, (25, 2))
    rotation = Rotation.from_rotvec([0.3, -2.0, 0.7])
    icrf = rotation.apply(model.unproject(uv))
    angle, root = rng.uniform(0, np.pi, 25), np.array([0.05, 1.5])
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                      ).transpose(2, 0, 1)
    factor = turned * root
    seen = uv + np.einsum('nij,nj->ni', factor, rng.normal(size=(25, 2)))
    R = factor @ factor.transpose(0, 2, 1)
    sigma = model.pixel_rad * np.sqrt(np.trace(R, axis1=1, axis2=2) / 2)
    start = solve('quest', model.unproject(seen), icrf, sigma)
    found = fit_error_ellipses(camera, seen, R[:, [0, 0, 1], [0, 1, 1]], icrf, start)

    def whitened(x):
        turn = 1e-5 * (x - 1)
        attitude = Rotation.from_quat(found.quaternion) * Rotation.from_rotvec(turn)
        away = seen - model.project(attitude.inv().apply(icrf))
        return np.einsum('nij,nj->ni', np.linalg.inv(factor), away).ravel()

    expected = least_squares(whitened, np.ones(3), diff_step=1e-3)
    covariance = 1e-10 * np.linalg.inv(expected.jac.T @ expected.jac)
    assert (np.abs(1e-5 * (expected.x - 1)) < 0.01 * np.sqrt(np.diag(covariance))).all()
    close_covariance(found.covariance, covariance, 0.01)
    assert found.chi2 == pytest.approx(2 * expected.cost, rel=1e-3)
    assert (turn_between(found.quaternion, rotation.as_quat())
            < turn_between(start.quaternion, rotation.as_quat()))


# --- covariances ---


def test_covariances_of_systematic_errors_are_those_of_the_record():
    for one, expected in zip(covariance_inputs(), record()['covariances'], strict=True):
        count, camera = len(one.sigma), camera_struct(one.camera)
        common = one.common[[0, 0, 1], [0, 1, 1]]
        stars = one.sensor, one.sigma
        found = [
            filled('stt_velocity_covariance', (3, 3), 250.0, *stars, count),
            filled('stt_lens_covariance', (3, 3), 1e-5, 2e-4, *stars, count),
            filled('stt_epoch_covariance', (3, 3), one.q, 3.0, *stars, one.motion, count),
            filled('stt_pointing_covariance', (3, 3), camera, common, None),
            filled('stt_pointing_covariance', (3, 3), camera, common, one.rate)]
        for matrix, of in zip(found, expected[:45].reshape(5, 3, 3)):
            close_covariance(matrix, of, CLOSE)
        close(protection_level(one.P, *stars, one.residual), expected[45:48], CLOSE)
        close(protection_level(one.P, *stars, one.residual, np.array([1e-4, 1e-3]), 2),
              expected[48:], CLOSE)
    assert not filled('stt_epoch_covariance', (3, 3), one.q, 3.0, *stars, None, count).any()


def test_systematic_errors_turn_the_best_fit_of_the_stars():
    """The turn by each shift of stars, by the normal equations of the fit, and their sum."""
    one = covariance_inputs()[3]
    count, p, weight = len(one.sigma), one.sensor, one.sigma ** -2
    F = sum(w * (np.eye(3) - np.outer(a, a)) for w, a in zip(weight, p))

    def covariance(shifts):
        turns = [np.linalg.solve(F, weight @ np.cross(p, shift)) for shift in shifts]
        return sum(np.outer(turn, turn) for turn in turns)

    by_velocity = [250.0 / 299792458.0 * (axis - np.outer(p @ axis, [1, 1, 1]) * p)
                   for axis in np.eye(3)]
    close_covariance(filled('stt_velocity_covariance', (3, 3), 250.0, p, one.sigma, count),
                     covariance(by_velocity), 1e-6)
    by_star = [1e-5 * np.where(np.arange(count)[:, None] == star, np.cross(axis, p), 0.0)
               for star in range(count) for axis in np.eye(3)]
    by_scale = [2e-4 * (p - [0, 0, 1])]
    close_covariance(filled('stt_lens_covariance', (3, 3), 1e-5, 2e-4, p, one.sigma, count),
                     covariance(by_star + by_scale), 1e-2)
    by_year = [3.0 * Rotation.from_quat(one.q).inv().apply(one.motion)]
    close_covariance(filled('stt_epoch_covariance', (3, 3), one.q, 3.0, p, one.sigma, one.motion,
                            count), covariance(by_year), 1e-6)


def test_the_terms_of_an_error_budget_add_up():
    budget, rng = np.zeros((), native.BUDGET), np.random.default_rng(3)
    for name in native.BUDGET.names:
        budget[name] = rng.normal(size=(3, 3))
    close(filled('stt_covariance_of', (3, 3), budget),
          sum(budget[name] for name in native.BUDGET.names), EXACT)


@pytest.mark.parametrize('matrix, expected', [
    (np.eye(3), True), (np.diag([1.0, 1.0, 0.0]), False), (np.diag([1.0, 1.0, np.nan]), False),
    (np.diag([1.0, np.inf, 1.0]), False), (np.eye(3) + 0.1 * np.eye(3, k=1), False),
    (np.eye(3) + 2 * (np.eye(3, k=1) + np.eye(3, k=-1)), False)])
def test_a_covariance_is_finite_symmetric_and_positive_definite(matrix, expected):
    assert bool(call('stt_is_covariance', matrix)) == expected


# --- the protection level ---


def level_by_separations(P, sensor, sigma, residual, k):
    """Return the level (3,) by the equations of protection.h, matrix by matrix."""
    F_of = [(np.eye(3) - np.outer(p, p)) / s ** 2 for p, s in zip(sensor, sigma)]
    F = sum(F_of)
    separations, more = [], []
    for p, s, r, F_i in zip(sensor, sigma, residual, F_of):
        A = np.linalg.inv(F - F_i)
        separations.append(r / s ** 2 * np.linalg.norm(np.cross(A, p), axis=1))
        more.append(np.diag(A - np.linalg.inv(F)))
    separations, more, variance = np.array(separations), np.array(more), np.diag(P)
    two = [np.sort(one, axis=0)[-2:].sum(axis=0) for one in (separations, more)]
    return np.max([k[0] * np.sqrt(variance),
                   *(separations + k[1] * np.sqrt(variance + more)),
                   two[0] + k[2] * np.sqrt(variance + two[1])], axis=0)


@pytest.mark.parametrize('count', [4, 5, 14, 40])
def test_the_level_is_the_largest_bound_of_all_hypotheses(count):
    rng = np.random.default_rng(count)
    sensor, _, sigma = directions(rng, count)
    P = 1.2 * cramer_rao(sensor, sigma)
    residual = np.abs(rng.normal(size=count)) * sigma
    p = 1e-3  # likely enough for pairs to count
    one, two, three = (math.comb(count, k) * p ** k for k in (1, 2, 3))
    share = 1e-7 / 3
    k = [-ndtri(share / each / 2) for each in (1, one, two)]
    # Three false stars at a time are subtracted from what is allowed.
    found = protection_level(P, sensor, sigma, residual, np.array([1e-7 + three, p]))
    close(found, level_by_separations(P, sensor, sigma, residual, k), 1e-9)


def test_few_stars_and_what_is_not_known_have_no_bound():
    sensor, _, sigma = directions(np.random.default_rng(1), 6)
    P, residual = cramer_rao(sensor, sigma), np.zeros(6)
    assert np.isfinite(protection_level(P, sensor, sigma, residual)).all()
    for count in (1, 2):
        assert np.isinf(protection_level(P, sensor[:count], sigma[:count], residual[:count])).all()
    # Without one of the two that are not in one place the roll is not known.
    near = np.concatenate([sensor[:1], sensor[:1], sensor[1:2]])
    assert np.isinf(protection_level(P, near, sigma[:3], residual[:3])).all()
    unknown = np.where(np.arange(6) == 3, np.nan, 0.0)
    assert np.isinf(protection_level(P, sensor, sigma, unknown)).all()
    assert np.isinf(protection_level(P, sensor, sigma, residual, np.array([1e-12, 1e-2]))).all()
    more = protection_level(P, sensor, sigma, residual, PROBABILITIES, rejected=3)
    assert (more > protection_level(P, sensor, sigma, residual)).all()


# --- rows and lens ---


@pytest.mark.parametrize('fault', ROW_FAULTS)
@pytest.mark.parametrize('name', runs_with('rows/star'))
def test_rows_and_lens_show_what_they_did(name, fault):
    run = of_run(name)
    frames, camera = spans(run['rows/stars']), run['camera']
    first = len(frames) * ROW_FAULTS.index(fault)
    lens, memory, seen = native_integrity.LensError(camera), np.zeros(4), []
    for index, frame in enumerate(frames):
        star = with_row_fault(fault, run['rows/star'][frame], camera, lens.scale)
        text = find_pattern(camera, star[:, 1:], memory)
        expected = run['rows/known'][first + index]
        assert text == run['rows/text'][first + index]
        is_first = lens.add(star[:, 0], star[:, 1:])
        assert is_first == bool(expected[3])
        close([lens.value_px, lens.scale, lens.scale_sigma], expected[:3], CLOSE, 1e-9)
        close(memory, expected[4:], CLOSE, 1e-3)
        seen.append((text, lens.value_px, lens.scale))
    texts, value_px, scale = zip(*seen)
    moving = 'list' not in name
    assert any('torn' in text for text in texts) == (fault == 'torn' and moving)
    assert any('line_time_us' in text for text in texts) == (fault == 'line time' and moving)
    assert (fault != 'stars off') or value_px[-1] > 0.1
    assert (fault != 'scale') or scale[-1] == pytest.approx(1e-3, rel=0.1)


def test_patterns_of_rows_are_least_squares_fits():
    name = runs_with('rows/star')[0]
    run = of_run(name)
    star, camera = run['rows/star'][spans(run['rows/stars'])[2]][:, 1:], run['camera']
    height, count = camera['height_px'], len(star)
    product, energy, edges, chi2 = fit_rows(camera, star)
    inverse_root = [np.linalg.inv(np.linalg.cholesky([[a, b], [b, c]]))
                    for a, b, c in star[:, 4:7]]

    def whitened(pairs):
        return np.concatenate([root @ pair for root, pair in zip(inverse_root, pairs)])

    rows = (star[:, 1] - (height - 1) / 2) / height
    away = (star[:, :2] - [camera['cx_px'], camera['cy_px']]) / height
    flow = star[:, 7:13].reshape(count, 2, 3)
    removed = np.column_stack([
        *(whitened(flow[:, :, k]) for k in range(3)), whitened(away),
        whitened(away * np.sum(away ** 2, axis=1, keepdims=True))])
    patterns = [rows, *(np.where(rows > edge, 0.5, -0.5) for edge in edges)]
    r = whitened(star[:, 2:4])
    left = r - removed @ np.linalg.lstsq(removed, r, rcond=None)[0]
    assert chi2 == pytest.approx(left @ left, rel=1e-9)
    for k, g in enumerate(patterns):
        both = np.column_stack([removed, whitened(star[:, 13:] * g[:, None])])
        rest = r - both @ np.linalg.lstsq(both, r, rcond=None)[0]
        assert product[k] ** 2 / energy[k] == pytest.approx(
            left @ left - rest @ rest, rel=1e-6, abs=1e-9 * chi2)


def estimated(stays_px, seed, frames=80):
    """Return what is estimated of stars with noise and an error that stays."""
    run, rng = of_run(runs_with('rows/star')[0]), np.random.default_rng(seed)
    star = run['rows/star'][spans(run['rows/stars'])[2]].copy()
    lens = native_integrity.LensError(run['camera'])
    stays = rng.normal(0, stays_px, (len(star), 2))
    sigma_px = np.linspace(0.03, 0.2, len(star))
    star[:, [5, 7]], star[:, 6] = sigma_px[:, None] ** 2, 0.0
    for _ in range(frames):
        star[:, 3:5] = stays + rng.normal(size=stays.shape) * sigma_px[:, None]
        seen = rng.random(len(star)) < 0.9
        lens.add(star[seen, 0], star[seen, 1:])
    return lens


def test_noise_is_not_an_error_of_the_lens_and_what_stays_is():
    assert np.mean([estimated(0.0, seed).value_px > 0 for seed in range(60)]) <= 0.02
    values = np.array([estimated(0.2, seed).value_px for seed in range(40)])
    assert np.sqrt(np.mean(values ** 2)) == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize('fault', EXPECTED_FAULTS)
@pytest.mark.parametrize('name', runs_with('expected/star'))
def test_stars_elsewhere_contradict_as_they_did(name, fault):
    run = of_run(name)
    frames = list(zip(spans(run['expected/stars']), spans(run['expected/centroids']),
                      run['expected/present_px']))
    for index, (stars, seen, present_px) in enumerate(frames):
        star = run['expected/star'][stars]
        uv = with_stars_elsewhere(fault, star, run['expected/uv'][seen])
        expected = run['expected/text'][len(EXPECTED_FAULTS) * index
                                        + EXPECTED_FAULTS.index(fault)]
        assert contradiction(star, uv, present_px) == expected


def test_a_second_image_of_very_many_stars_contradicts():
    rng = np.random.default_rng(1)
    star = np.column_stack([rng.uniform(10, 1013, (1000, 2)), rng.normal(size=(1000, 2))])
    uv = np.where(star[:, 1:2] > 511, star[:, :2] + [12.0, -7.0], star[:, :2])
    assert 'second image' in contradiction(star, uv, 0.5)


# --- stamps and gyro ---


@pytest.mark.parametrize('fault', STAMP_FAULTS)
@pytest.mark.parametrize('name', runs_with('stamps/numbers'))
def test_stamps_have_the_errors_that_they_had(name, fault):
    run = of_run(name)
    numbers = with_stamp_errors(fault, run['stamps/numbers'])
    first = len(numbers) * STAMP_FAULTS.index(fault)
    jitter = native_integrity.StampJitter()
    for index, ((before_ns, stamp_ns, interrupted), frame) in enumerate(
            zip(run['stamps/ns'], numbers)):
        if interrupted:
            jitter.interrupt()
        jitter.add((before_ns, stamp_ns), frame[:7], frame[7:14], frame[14:21], frame[21:24],
                   frame[24:])
        expected = run['stamps/known'][first + index]
        close([jitter.sigma_s, *jitter.turn_rad], expected, EXACT,
              [1e-6, *[1e-6 * np.linalg.norm(frame[18:21])] * 3])


def test_errors_of_stamps_are_estimated():
    run = of_run('slews to 3 deg/s, gyro')
    known = run['stamps/known'].reshape(len(STAMP_FAULTS), -1, 4)[:, :, 0]
    assert known[0].max() == 0 and 2e-3 < known[1].max() < 1e-2


def jitter_of(sigma_s, seed, frames=60):
    """Return the sigma estimated of such timestamp errors, of a body that turns steadily."""
    rng, jitter = np.random.default_rng(seed), native_integrity.StampJitter()
    rate, noise_rad, found = np.array([0.01, -0.015, 0.003]), 2e-6, []
    states = [np.concatenate([Rotation.from_rotvec(0.1 * k * rate).as_quat(), rate])
              for k in range(frames + 1)]
    for k in range(frames):
        turn = rng.normal(0, sigma_s) * rate + rng.normal(0, noise_rad, 3)
        jitter.add((k * 10 ** 8, (k + 1) * 10 ** 8), states[k], states[k + 1], states[k + 1],
                   turn, noise_rad ** 2 * np.eye(3))
        found.append(jitter.sigma_s)
    return np.array(found[30:])


def test_the_deviation_of_the_stamps_is_measured():
    found = np.concatenate([jitter_of(5e-3, seed) for seed in range(30)])
    assert np.sqrt(np.mean(found ** 2)) == pytest.approx(5e-3, rel=0.25)
    assert np.mean([jitter_of(0.0, seed).max() > 0 for seed in range(30)]) <= 0.1


@pytest.mark.parametrize('name', runs_with('gyro/frame'))
def test_a_gyro_agrees_or_not_as_it_did(name):
    run = of_run(name)
    found = compare_gyro(run['gyro/rate_ns'], run['gyro/rate'], run['gyro/frame_ns'],
                         run['gyro/frame'])
    assert found.tolist() == run['gyro/found'].tolist()
    assert (found[:, 0].any(), found[:, 1].max() > 50) == (
        (True, False) if 'in deg/s' in name else (False, True))
    assert len(GYRO_OPTIONS) == 4


# --- what is published ---


def same_outcome(found, expected, text, relative):
    """Compare an attitude, or the reason for none, with the record."""
    if text != 'trusted':
        assert sentence(found.code, found.figures) == text
        return
    assert found.code == TRUSTED
    covariance = expected[4:13].reshape(3, 3)
    assert turn_between(found.numbers[:4], expected[:4]) < 1e-7 * np.sqrt(covariance[0, 0])
    close_covariance(found.numbers[4:13].reshape(3, 3), covariance, relative)
    close(found.numbers[13], expected[13], relative)
    close(found.numbers[15:], expected[15:], relative)


@pytest.mark.parametrize('name', runs_with('tracks/star'))
def test_tracks_are_trusted_as_they_were(name):
    run, texts = of_run(name), set()
    for index, stars in enumerate(spans(run['tracks/stars'])):
        attitude, text = run['tracks/attitude'][index], str(run['tracks/text'][index])
        found = trust_tracks(run['camera'], trust_options(), attitude[:4], attitude[4:13],
                             attitude[13], run['tracks/star'][stars])
        same_outcome(found, run['tracks/trusted'][index], text, EXACT)
        texts.add(text)
    assert len(texts) >= 3


@pytest.mark.parametrize('name', runs_with('solved/star'))
def test_identified_stars_are_trusted_as_they_were(name):
    run = of_run(name)
    for index, stars in enumerate(spans(run['solved/stars'])):
        for number, solver in enumerate(SOLVERS):
            row = 4 * index + number
            found = trust_stars(run['camera'], trust_options(solver), run['solved/star'][stars],
                                observer=(300.0, 2.0))
            same_outcome(found, run['solved/trusted'][row], str(run['solved/text'][row]), CLOSE)


def test_the_sign_goes_on_from_the_attitude_before():
    run = of_run(runs_with('tracks/star')[0])
    attitude, stars = run['tracks/attitude'][0], run['tracks/star'][spans(run['tracks/stars'])[0]]
    for sign in (1.0, -1.0):
        found = trust_tracks(run['camera'], trust_options(), attitude[:4], attitude[4:13], 0.0,
                             stars, previous=sign * attitude[:4])
        assert found.numbers[:4] @ attitude[:4] == pytest.approx(sign)


def test_a_covariance_that_is_invalid_is_not_published():
    run = of_run(runs_with('tracks/star')[0])
    attitude, stars = run['tracks/attitude'][0], run['tracks/star'][spans(run['tracks/stars'])[0]]
    broken = np.diag([1e-9, np.nan, 1e-9])
    found = trust_tracks(run['camera'], trust_options(), attitude[:4], broken, 0.0, stars)
    assert sentence(found.code, found.figures).startswith(
        'the covariance of the attitude is not positive definite, its diagonal is [1e-09, nan')


# --- impossible numbers ---

STRANGE = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e300, 1e154])


def damaged(rng, array):
    """Return a copy of which some numbers are impossible."""
    array = array.copy()
    places = rng.random(array.shape) < rng.choice([0.02, 0.2, 1.0])
    array[places] = rng.choice(STRANGE, np.count_nonzero(places))
    return array


@pytest.mark.parametrize('seed', range(40))
def test_impossible_numbers_give_no_attitude_that_is_invalid(seed):
    rng, run = np.random.default_rng(seed), of_run(runs_with('tracks/star')[0])
    camera, options = run['camera'], trust_options(SOLVERS[seed % 4])
    stars = run['solved/star'][spans(run['solved/stars'])[0]]
    tracks = run['tracks/star'][spans(run['tracks/stars'])[0]]
    attitude = run['tracks/attitude'][0]
    for found in (
            trust_stars(camera, options, damaged(rng, stars), (300.0, 2.0)),
            trust_tracks(camera, options, attitude[:4], attitude[4:13], 0.0,
                         damaged(rng, tracks)),
            trust_tracks(camera, options, *map(partial(damaged, rng), (
                attitude[:4], attitude[4:13])), 0.0, tracks)):
        if found.code == TRUSTED:
            covariance = found.numbers[4:13].reshape(3, 3)
            sigma = np.sqrt(np.diag(covariance))
            assert np.linalg.eigvalsh(covariance / np.outer(sigma, sigma)).min() > -1e-12
            assert np.linalg.norm(found.numbers[:4]) == pytest.approx(1)
            assert not np.isnan(found.numbers[15:]).any()
        else:
            assert found.code > TRUSTED


@pytest.mark.parametrize('seed', range(20))
def test_impossible_numbers_are_remembered_without_harm(seed):
    """Nothing is read or written beyond its place: sanitizers see that."""
    rng, run = np.random.default_rng(seed), of_run(runs_with('rows/star')[0])
    camera, lens, memory = run['camera'], native_integrity.LensError(run['camera']), np.zeros(4)
    for frame in spans(run['rows/stars'])[:6]:
        star = damaged(rng, run['rows/star'][frame][:, 1:])
        find_pattern(camera, star, memory)
        lens.add(run['rows/star'][frame][:, 0], star)
        contradiction(damaged(rng, star[:, :4]), damaged(rng, star[:, :2]), 0.5)
    numbers = of_run(runs_with('stamps/numbers')[0])['stamps/numbers']
    jitter = native_integrity.StampJitter()
    for index, frame in enumerate(damaged(rng, numbers[:30])):
        jitter.add((index * 10 ** 8, (index + 1) * 10 ** 8), frame[:7], frame[7:14], frame[14:21],
                   frame[21:24], frame[24:])
