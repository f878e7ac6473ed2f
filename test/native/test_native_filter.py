# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The filter of the native core: as recorded (filter.npz), by textbook filters, by motions.

Sums keep their order: numbers of a record are equal to 1e-12 of their own sigma, those behind an
inverse or a product of matrices to 1e-9.
"""

from functools import cache

import native_filter as native
from native_filter import (
    CENTRE, HEADS, KIND, MODES, Motion, SIZE, State, STEADY, SWING, TORQUE, TRACKER, W2)
import numpy as np
import pytest
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotation_vector_from_quaternion)

EXACT, SOLVED = 1e-12, 1e-9
STEP_S = 0.1
SIGMA = 2e-6
ACCELERATION = np.full(3, np.radians(0.05))
NO_RATES = np.empty((0, 3)), np.empty(0)
NO_WALK = np.zeros(3)
WRONG_SIGMAS = 5.0
BOTH = pytest.mark.parametrize('own', [TRACKER, HEADS], ids=['tracker', 'heads'])


def turned(q, rotation):
    return multiply(q, quaternion_from_rotation_vector(rotation))


def rotation_between(q, other):
    return rotation_vector_from_quaternion(multiply(conjugate(q), other))


# --- the record ---


@cache
def archive() -> dict[str, np.ndarray]:
    with np.load(native.RECORD) as file:
        return dict(file)


@cache
def calls(key: str) -> list:
    """Return what was recorded under a name, one element a call."""
    flat, shapes = archive()[key], archive().get(f'{key} shape')
    if shapes is None:
        return flat.tolist()
    count = len(flat) // int(np.prod(shapes[0])) if len(shapes) == 1 else len(shapes)
    shapes = np.broadcast_to(shapes, (count, shapes.shape[1]))
    ends = np.cumsum(np.prod(shapes, axis=1))
    return [part.reshape(shape) for part, shape in zip(np.split(flat, ends[:-1]), shapes)]


@cache
def modes(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (9, N) and covariance (9, N, N)."""
    mean, lower = calls('mean')[number], calls('covariance')[number]
    n = mean.shape[1]
    P = np.empty((MODES, n, n))
    rows, columns = np.tril_indices(n)
    P[:, rows, columns] = P[:, columns, rows] = lower
    return mean, P


def motions(key: str) -> list[Motion]:
    found = []
    for stamp_ns, number, one in zip(
            calls(f'{key} stamp_ns'), calls(f'{key} modes'), calls(f'{key} numbers')):
        found.append(Motion(stamp_ns, one[:4], *modes(number), one[4:13], one[13:22], one[22:25],
                            one[25], one[26], one[27:]))
    return found


def states(key: str) -> list[State]:
    return [State(*one) for one in zip(*(
        calls(f'{key}.{name}') for name in State._fields))]


def recorded(function: str, *names: str):
    """Return the arguments of all calls of a function."""
    return zip(*(motions(f'{function} {name}') if f'{function} {name} modes' in archive()
                 else states(f'{function} {name}') if f'{function} {name}.rate' in archive()
                 else calls(f'{function} {name}') for name in names))


def close(found, expected, relative=EXACT, scale=0.0):
    """Compare arrays, to a share of the expected one or of a scale."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    assert found.shape == expected.shape
    limit = relative * np.maximum(np.abs(expected), scale)
    equal = (found == expected) | (np.isnan(found) & np.isnan(expected))
    with np.errstate(invalid='ignore'):
        assert (equal | (np.abs(found - expected) <= limit)).all(), (found, expected)


def sigmas_of(P):
    return np.sqrt(np.abs(np.einsum('...ii->...i', P)))


def same_covariance(found, expected, relative=EXACT):
    sigma = sigmas_of(expected)
    close(found, expected, relative, sigma[..., :, None] * sigma[..., None, :] + 1e-300)


def same_motion(found: Motion, expected: Motion, relative=EXACT):
    assert found.stamp_ns == expected.stamp_ns and found.frames == expected.frames
    same_covariance(found.covariance, expected.covariance, relative)
    # A turn is the difference of quaternions, whose last digit is 2e-16 rad.
    close(found.mean, expected.mean, relative, sigmas_of(expected.covariance) + 1e-3)
    close(found.quaternion, expected.quaternion, EXACT, 1.0)
    for name in ('weight', 'share', 'noise', 'interval_s'):
        close(getattr(found, name), getattr(expected, name), 10 * relative)
    swing, noise = expected.swing, np.sqrt(expected.noise.max())
    close(found.swing[:13], swing[:13], SOLVED, noise)
    close(found.swing[13:], swing[13:], SOLVED, 1.0)


def same_state(found: State, expected: State, relative=EXACT):
    sigma = sigmas_of(expected.covariance)
    assert found.stamp_ns == expected.stamp_ns
    # Of corrections by 1e-4 rad.
    turn = rotation_between(found.quaternion, expected.quaternion)
    assert np.abs(turn).max() < 1e-15 + 1e-4 * relative
    close(found.rate, expected.rate, relative, sigma[3:6])
    close(found.drift, expected.drift, relative, sigma[6:9])
    same_covariance(found.covariance, expected.covariance, relative)


@BOTH
def test_predictions_are_those_of_the_record(own):
    count = 0
    for *given, expected in recorded('predicted', 'motion', 'to_ns', 'dt_s', 'measured',
                                     'variance', 'acceleration', 'walk', 'result'):
        same_motion(own.predicted(*given), expected)
        count += len(given[4]) > 0
    assert count > 3, 'some have rates of a gyro'


@BOTH
def test_updates_are_those_of_the_record(own):
    sizes = set()
    for *given, expected in recorded('updated', 'motion', 'quaternion', 'rate', 'information',
                                     'vector', 'beside', 'moved', 'result'):
        # Of wide modes the frame leaves a millionth of the variance.
        same_motion(own.updated(*given), expected, SOLVED)
        sizes.add((len(given[4]), bool(given[5].any())))
    assert sizes == {(3, False), (3, True), (6, True)}


@BOTH
def test_noise_and_swing_are_those_of_the_record(own):
    swings = 0
    for *given, expected in recorded(
            'with_measured', 'motion', 'before_ns', 'quaternion', 'R', 'result'):
        same_motion(own.with_measured(*given), expected)
        swings += expected.swing[W2] > 0
    assert swings > 3


@BOTH
def test_what_is_published_is_that_of_the_record(own):
    vibrations = 0
    for motion, state, wide, tails, experience, mean, acceleration, course, vibration in recorded(
            'published', 'motion', 'state', 'wide', 'tails', 'experience', 'mean_acceleration',
            'acceleration', 'course', 'vibration'):
        same_state(own.state_of(motion), state)
        same_state(own.state_of(motion, motion.weight * np.isin(np.arange(MODES), [3, 8])), wide)
        same_covariance(own.with_tails(motion, state.covariance[:6, :6]), tails)
        close(own.acceleration_of(motion), mean, EXACT, np.abs(mean).max())
        close(native.by_experience(motion.weight, motion.share), experience)
        found = native.course_of(motion, acceleration)
        close(found, course, SOLVED, np.abs(course[1:2]) + np.abs(course[2:3]) * STEP_S)
        close(native.vibration_covariance(motion), vibration)
        vibrations += vibration.any()
    assert vibrations


def test_covariance_deficits_are_those_of_the_record():
    found = 0
    for *given, expected in recorded(
            'deficit', 'covariance', 'error', 'across', 'probability', 'result'):
        same_covariance(native.covariance_deficit(*given), expected)
        found += expected.any()
    assert found


@pytest.mark.parametrize('run', range(2))
def test_a_gyro_says_what_that_of_the_record_did(run):
    stamps, rates = calls('gyro stamp_ns')[run], calls('gyro rates')[run]
    gyro = native.Gyro(np.array([3.0, 0.15, 100.0, 0.1]), stamps, rates)
    assert len(gyro) == len(stamps)
    for number, from_ns, to_ns, before, after, *between in recorded(
            'between', 'run', 'from_ns', 'to_ns', 'before', 'after', 'dt_s', 'measured',
            'variance', 'mean', 'mean_variance'):
        if number != run:
            continue
        found = gyro.propagate(before, to_ns)
        # Many turns in a row.
        assert np.abs(rotation_between(found.quaternion, after.quaternion)).max() < 1e-14
        same_state(found._replace(quaternion=after.quaternion), after, SOLVED)
        dt_s, measured, variance = gyro.rates(from_ns, to_ns)
        mean, mean_variance = gyro.mean_rate(from_ns, to_ns)
        for one, expected in zip((dt_s, measured, variance, mean, mean_variance), between):
            close(one, expected, EXACT, 1e-12)


def corrections():
    names = ('camera', 'icrf', 'usable', 'min_stars', 'predicted', 'uv', 'error', 'delay_s',
             'detection')
    for number, one in enumerate(recorded('correct', *names)):
        yield number, dict(zip(names, one))


def corrected(given):
    error = given['error']
    centroid = np.column_stack([given['uv'], error[:, 0, 0], error[:, 0, 1], error[:, 1, 1],
                                given['delay_s']])
    return native.correct(
        native.camera_of(given['camera']), given['icrf'], given['usable'], given['min_stars'],
        given['predicted'], centroid, given['detection'])


def test_corrections_are_those_of_the_record():
    agreed = set()
    for number, given in corrections():
        found = corrected(given)
        expected = {key.removeprefix('correct '): calls(key)[number] for key in archive()
                    if key.startswith('correct ') and '.' not in key and 'shape' not in key}
        assert found.agreed == expected['agreed']
        assert found.star.tolist() == np.flatnonzero(expected['inside']).tolist()
        assert found.unassociated.tolist() == expected['unassociated'].tolist()
        assert found.inlier.tolist() == expected['inlier'].tolist()
        assert found.stars == expected['stars']
        close(found.predicted, expected['at'], EXACT, 1.0)
        beta = np.zeros_like(found.probability)
        beta[expected['beta_row'], expected['beta_column']] = expected['beta']
        close(found.probability, beta, SOLVED, 1e-3)
        seen = found.probability[:, 0] <= 0.5
        assert found.best[seen].tolist() == expected['best'][seen].tolist()
        scale = np.abs(expected['information']).max() ** 0.5
        close(found.information, expected['information'], SOLVED,
              np.abs(expected['information']).max(axis=0))
        close(found.vector, expected['vector'], SOLVED, scale)
        state = states('correct state')[number]
        # What is left of a variance has the rounding of all of it.
        left = state.covariance[0, 0] / given['predicted'].covariance[0, 0]
        relative = max(SOLVED, 1e-14 / left)
        same_state(found.state, state, relative)
        close(found.distance_px, expected['distance'], relative, 1.0)
        close(found.normalised, expected['normalised'], relative, 1.0)
        agreed.add((found.agreed, len(found.vector)))
        if not found.agreed:
            continue
        same_covariance(found.turn_covariance, expected['turn_covariance'], SOLVED)
        close(found.turn, expected['turn'], SOLVED, sigmas_of(expected['turn_covariance']))
        close(found.innovation, expected['innovation'], SOLVED, 1.0)
        close(found.by_acceleration, expected['by_acceleration'], SOLVED,
              np.abs(expected['by_acceleration']).max())
        # Of equal errors any half may be the precise one.
        error = given['error'][found.best[found.inlier]]
        precise = 3 if len(np.unique(np.linalg.det(error))) < len(error) else 4
        close(found.figures[:precise], [expected[name] for name in (
            'residual_px', 'chi2', 'typical', 'precise')[:precise]], relative)
    assert agreed >= {(True, 3), (True, 6)}


def test_stars_in_the_image_are_those_of_the_record():
    for camera, icrf, state, expected, covariance in recorded(
            'on_image', 'camera', 'icrf', 'state', 'states', 'covariances'):
        found = native.on_image(native.camera_of(camera), icrf, state)
        close(found[0], expected, EXACT, 1.0)
        same_covariance(found[1], covariance, SOLVED)


def test_rows_of_a_rolling_shutter_are_brought_to_one_time_as_in_the_record():
    for camera, *given, expected in recorded(
            'late', 'camera', 'uv', 'delay_s', 'rate', 'acceleration', 'result'):
        close(native.at_frame_time(native.camera_of(camera), *given), expected)
    for camera, *given, expected in recorded(
            'fit_rate', 'camera', 'icrf', 'uv', 'sigma_px', 'delay_s', 'quaternion', 'result'):
        close(native.fit_rate(native.camera_of(camera), *given), expected, 1e-8,
              np.abs(expected).max())
        few = [one[:5] for one in given[:4]]
        assert native.fit_rate(native.camera_of(camera), *few, given[4]) is None
        at_once = [*given[:3], np.full_like(given[3], 0.01), given[4]]
        assert native.fit_rate(native.camera_of(camera), *at_once) is None


# --- the motion ---


def at_rest(rate=(0.0, 0.0, 0.0), own=TRACKER):
    """Return the motion of a body of which two frames are known."""
    R = np.eye(3) * SIGMA ** 2
    P = np.zeros((9, 9))
    P[:3, :3], P[3:6, 3:6] = R, 2 * R / STEP_S ** 2
    P[:3, 3:6] = P[3:6, :3] = R / STEP_S
    state = State(0, np.array([0.0, 0.0, 0.0, 1.0]), np.array(rate), np.zeros(3), P)
    return own.started(state, np.full(3, SIGMA ** 2), STEP_S)


def stepped(motion, own=TRACKER, acceleration=ACCELERATION, step_s=STEP_S, walk=NO_WALK):
    return own.predicted(motion, motion.stamp_ns + round(step_s * 1e9), np.array([step_s]),
                         *NO_RATES, acceleration, walk)


def of_mode(motion, mode):
    """Return a motion that has been in one mode for long."""
    one = np.eye(MODES)[mode]
    return motion._replace(weight=one, share=one)


def flown(angles, rng, about=(1.0, 0.0, 0.0)):
    """Yield motion and true attitude after each frame of a body turned by angles (K,) rad."""
    R, about = np.eye(3) * SIGMA ** 2, np.array(about)
    start = np.array([0.0, 0.0, 0.0, 1.0])
    motion = at_rest(about * (angles[1] - angles[0]) / STEP_S)
    motion = motion._replace(quaternion=turned(start, about * angles[0]))
    for angle in angles[1:]:
        truth = turned(start, about * angle)
        seen = turned(truth, SIGMA * rng.standard_normal(3))
        before_ns, motion = motion.stamp_ns, stepped(motion)
        information = np.linalg.inv(R)
        turn = rotation_between(motion.quaternion, seen)
        motion = TRACKER.updated(motion, motion.quaternion, np.zeros(3), information,
                                 information @ turn, np.zeros((3, 3)), np.zeros(3))
        motion = TRACKER.with_measured(motion, before_ns, seen, R)
        yield motion, truth


@BOTH
def test_a_mixture_has_mean_and_covariance_of_its_parts(own):
    rng = np.random.default_rng(1)
    motion = at_rest(own=own)
    roots = rng.standard_normal((MODES, 12, 12)) * 1e-3
    motion = motion._replace(weight=rng.uniform(0, 1, MODES),
                             mean=1e-3 * rng.standard_normal((MODES, 12)),
                             covariance=roots @ roots.transpose(0, 2, 1))
    share = motion.weight / motion.weight.sum()
    middle = share @ motion.mean
    away = motion.mean - middle
    P = np.einsum('m,mij->ij', share, motion.covariance) + np.einsum(
        'm,mi,mj->ij', share, away, away)
    seen = np.r_[0:6, 9:12]
    found = own.state_of(motion)
    same_covariance(found.covariance, P[np.ix_(seen, seen)])
    close(rotation_between(motion.quaternion, found.quaternion), middle[:3], SOLVED)
    close(np.r_[found.rate, found.drift], middle[seen[3:]])


def transition(motion, mode, step_s):
    """Return the Jacobian (12, 12) of the prediction of a mode, by differences."""
    def end(x):
        changed = motion.mean.copy()
        changed[mode] = x
        after = stepped(motion._replace(mean=changed), step_s=step_s, acceleration=np.zeros(3))
        return after.mean[mode], turned(after.quaternion, after.mean[mode, :3])

    x, size, columns = motion.mean[mode], 1e-4, []
    _, middle = end(x)
    for k in range(12):
        above, below = (end(x + sign * size * np.eye(12)[k]) for sign in (1, -1))
        change = above[0] - below[0]
        change[:3] = rotation_between(middle, above[1]) - rotation_between(middle, below[1])
        columns.append(change / (2 * size))
    return np.array(columns).T


@pytest.mark.parametrize('mode', range(MODES))
def test_a_covariance_is_carried_by_the_jacobian_of_its_mode(mode):
    """Without process noise P <- Phi P Phi^T, Phi by differences of the prediction."""
    rng = np.random.default_rng(mode)
    root = 1e-4 * rng.standard_normal((12, 12))
    # Of small turns and rates: at others the acceleration turns about axes that turn.
    motion = of_mode(at_rest((1e-3, -2e-3, 3e-3)), mode)
    swing = motion.swing.copy()
    swing[W2], swing[CENTRE] = 9.0, (1e-3, 2e-3, -1e-3)
    motion = motion._replace(covariance=np.tile(root @ root.T, (MODES, 1, 1)), swing=swing,
                             noise=np.zeros(3))
    Phi = transition(motion, mode, STEP_S)
    after = stepped(motion, acceleration=np.zeros(3))
    same_covariance(after.covariance[mode], Phi @ root @ root.T @ Phi.T, 1e-3)


@pytest.mark.parametrize('mode', range(MODES))
def test_one_step_is_as_many_short_ones(mode):
    """Phi and Q of a time are those of its halves."""
    motion = of_mode(at_rest(), mode)
    swing = motion.swing.copy()
    swing[W2] = 10.0
    motion = motion._replace(covariance=np.zeros_like(motion.covariance), swing=swing)
    whole = stepped(motion).covariance[mode, :6, :6]
    half = of_mode(stepped(motion, step_s=STEP_S / 2), mode)
    both = stepped(half, step_s=STEP_S / 2).covariance[mode, :6, :6]
    if KIND[mode] == SWING:
        # The noise of a swing is taken as that of a torque: its frequency changes it little.
        same_covariance(both, whole, 0.05)
    elif KIND[mode] == native.JUMP:
        # What a jump leaves as acceleration is noise of the next step alone.
        same_covariance(both, whole, 1e-9)
    else:
        same_covariance(both, whole, 1e-9)


@pytest.mark.parametrize('own', [TRACKER, HEADS])
@pytest.mark.parametrize('size', [3, 6])
def test_a_mode_alone_is_the_kalman_filter(own, size):
    """Of one mode of probability 1 the update is that of the textbook, whatever L is."""
    rng, P = np.random.default_rng(2), np.eye(12) + 0.1
    motion = of_mode(at_rest(own=own), 1)
    motion = motion._replace(covariance=np.tile(P, (MODES, 1, 1)))
    R, z = np.diag(rng.uniform(1, 3, size)), 1e-7 * rng.standard_normal(size)
    L, Y = 0.3 * rng.standard_normal((size, 3)), np.linalg.inv(R)
    after = own.updated(motion, motion.quaternion, np.zeros(3), Y, Y @ z, L, np.zeros(size))
    H = np.zeros((size, 12))
    H[:, :size], H[:, 6:9] = np.eye(size), L
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    np.testing.assert_allclose(after.covariance[1], P - K @ H @ P, rtol=1e-9, atol=1e-12)
    shift = rotation_between(motion.quaternion, after.quaternion) + after.mean[1, :3]
    np.testing.assert_allclose(np.r_[shift, after.mean[1, 3:]], K @ z, rtol=1e-6, atol=1e-15)


def test_the_modes_of_a_frame_have_the_probabilities_of_its_likelihoods():
    motion = stepped(at_rest())
    R, z = np.eye(3) * SIGMA ** 2, np.array([5.0, -3.0, 1.0]) * SIGMA
    Y = np.linalg.inv(R)
    after = TRACKER.updated(motion, motion.quaternion, np.zeros(3), Y, Y @ z, np.zeros((3, 3)),
                            np.zeros(3))
    away = z - motion.mean[:, :3]
    S = motion.covariance[:, :3, :3] + R
    likelihood = np.exp(-np.einsum('mi,mij,mj->m', away, np.linalg.inv(S), away) / 2) / np.sqrt(
        np.linalg.det(S))
    expected = motion.weight * likelihood
    np.testing.assert_allclose(after.weight, expected / expected.sum(), rtol=1e-6)


def test_a_jump_about_the_axis_of_those_before_is_more_probable():
    rng = np.random.default_rng(7)
    steps = np.repeat(rng.uniform(-12, 12, 20), 10) * SIGMA
    *_, (motion, _) = flown(np.cumsum(steps), rng, (0.0, 0.0, 1.0))
    assert motion.jumps[:2].max() < 0.1 * motion.jumps[2]
    # A step of three sigma, of which the noise of the frame hides one.
    sudden = []
    for jumps in (motion.jumps, np.ones(3)):
        before = stepped(motion._replace(jumps=jumps))
        mean = before.mean[STEADY, :3] + np.array([0.0, 0.0, 2.0]) * SIGMA
        after = TRACKER.updated(before, before.quaternion, np.zeros(3), np.eye(3) / SIGMA ** 2,
                                mean / SIGMA ** 2, np.zeros((3, 3)), np.zeros(3))
        sudden.append(after.weight[4])
    assert sudden[0] > 5 * sudden[1], sudden


def test_frames_one_after_the_other_are_one_batch():
    """Of one mode without noise, frames are the least squares of all of them."""
    rng, R = np.random.default_rng(6), np.diag([1.0, 2.0, 3.0]) * SIGMA ** 2
    motion = of_mode(at_rest(), STEADY)
    P, Y, rows, seen = motion.covariance[STEADY][:6, :6], np.linalg.inv(R), [], []
    for k in range(1, 6):
        motion = of_mode(stepped(motion, acceleration=np.zeros(3)), STEADY)
        z = SIGMA * rng.standard_normal(3)
        measured = turned(np.array([0.0, 0.0, 0.0, 1.0]), z)
        turn = rotation_between(motion.quaternion, measured)
        motion = TRACKER.updated(motion, motion.quaternion, np.zeros(3), Y, Y @ turn,
                                 np.zeros((3, 3)), np.zeros(3))
        motion = of_mode(motion, STEADY)
        rows.append(np.hstack([np.eye(3), k * STEP_S * np.eye(3)]))
        seen.append(z)
    information = np.linalg.inv(P) + sum(row.T @ Y @ row for row in rows)
    x = np.linalg.solve(information, sum(row.T @ Y @ z for row, z in zip(rows, seen)))
    Phi = np.eye(6)
    Phi[:3, 3:] = 5 * STEP_S * np.eye(3)
    same_covariance(motion.covariance[STEADY][:6, :6], Phi @ np.linalg.inv(information) @ Phi.T,
                    1e-5)
    end = TRACKER.state_of(motion)
    close(rotation_between(np.array([0.0, 0.0, 0.0, 1.0]), end.quaternion), (Phi @ x)[:3], 1e-5,
          SIGMA)
    close(end.rate, x[3:], 1e-5, SIGMA)


def test_rates_of_a_gyro_are_measurements():
    dt_s, rates = np.array([0.05, 0.05, 0.0]), np.tile([1e-3, 0.0, 0.0], (2, 1))
    motion = TRACKER.predicted(at_rest(), round(STEP_S * 1e9), dt_s, rates, np.full(2, 1e-16),
                               ACCELERATION, NO_WALK)
    # The drift is known to be zero here: the body turns as the gyro says.
    np.testing.assert_allclose(TRACKER.state_of(motion).rate, rates[0], rtol=0.01, atol=1e-6)


@pytest.mark.parametrize('angles, kinds', [
    (lambda t: 1e-3 * t, [STEADY, TORQUE]), (lambda t: 1e-4 * t ** 2, [TORQUE]),
    (lambda t: 1e-3 * np.sin(2 * np.pi * t / 1.3), [SWING])])
def test_the_mode_of_a_motion_is_found(angles, kinds):
    *_, (motion, _) = flown(angles(np.arange(60) * STEP_S), np.random.default_rng(3))
    assert motion.weight[np.isin(KIND, kinds) & (SIZE < 20)].sum() > 0.95


def test_period_and_mean_rate_of_a_swing_are_found():
    time_s = np.arange(60) * STEP_S
    *_, (motion, _) = flown(2e-3 * time_s + 1e-3 * np.sin(2 * np.pi * time_s / 1.3),
                            np.random.default_rng(4))
    assert 2 * np.pi / np.sqrt(motion.swing[W2]) == pytest.approx(1.3, rel=0.01)
    assert motion.swing[CENTRE.start] == pytest.approx(2e-3, rel=0.05)


@pytest.mark.parametrize('angles', [
    lambda t: 1e-3 * t, lambda t: 3e-4 * np.sin(2 * np.pi * t / 2.0),
    lambda t: np.where(t > 3, 1e-3 * (t - 3), 0.0), lambda t: 2e-5 * np.maximum(t - 3, 0) ** 2])
def test_errors_are_within_the_covariance_and_it_stays_positive(angles):
    rng, squares = np.random.default_rng(5), []
    time_s = np.arange(80) * STEP_S
    for _ in range(6):
        for k, (motion, truth) in enumerate(flown(angles(time_s + rng.uniform(0, STEP_S)), rng)):
            state = TRACKER.state_of(motion)
            P = TRACKER.with_tails(motion, state.covariance[:6, :6])
            for whole in (P, *motion.covariance[:, :6, :6]):
                assert (whole == whole.T).all()
                np.linalg.cholesky(whole)
            error = rotation_between(state.quaternion, truth)
            assert (np.abs(error) < WRONG_SIGMAS * np.sqrt(np.diag(P))[:3]).all(), k
            squares.append(error @ np.linalg.solve(P[:3, :3], error))
    assert 1.0 < np.mean(squares[3:]) < 4.0


def test_a_frame_does_not_change_the_modes_that_stay():
    """Shares of modes not seen shrink, weights add up to one, and quaternions stay unit."""
    motion = at_rest()
    for _ in range(30):
        motion = stepped(motion)
        assert motion.weight.sum() == pytest.approx(1, abs=1e-12)
        assert np.linalg.norm(motion.quaternion) == pytest.approx(1, abs=1e-14)


@BOTH
def test_a_motion_goes_on_from_a_state(own):
    rng, motion = np.random.default_rng(7), stepped(at_rest(own=own), own)
    root = 1e-4 * rng.standard_normal((9, 9))
    state = State(5, turned(motion.quaternion, rng.standard_normal(3)), rng.standard_normal(3),
                  rng.standard_normal(3), root @ root.T)
    after = own.restarted(motion, state)
    same_state(own.state_of(after), state)
    assert (after.weight == motion.share).all()
    assert (after.mean[:, 6:9] == motion.mean[:, 6:9]).all()
    assert (after.covariance[:, 6:9, 6:9] == motion.covariance[:, 6:9, 6:9]).all()
    assert not after.covariance[:, 6:9, :6].any() and not after.covariance[:, 9:, 6:9].any()
    known = own.resumed(at_rest(own=own), after)
    assert (known.weight == after.weight).all() and (known.share == after.share).all()
    assert known.stamp_ns == 0 and (known.covariance == at_rest(own=own).covariance).all()
    assert np.isnan(own.interrupted(known).swing[:13]).all()


def test_a_covariance_that_is_invalid_stays_so():
    """NaN is not replaced by the least variance of a mode."""
    motion, P = stepped(at_rest()), np.full((6, 6), np.nan)
    assert np.isnan(TRACKER.with_tails(motion, P)).all()
    broken = motion.covariance.copy()
    broken[0, 0, 0] = np.nan
    assert np.isnan(TRACKER.state_of(motion._replace(covariance=broken)).covariance[0, 0])


def test_the_sigma_of_an_axis_covers_improbable_modes():
    motion = at_rest()
    weight = np.eye(MODES)[0] * 0.999 + np.eye(MODES)[8] * 0.001
    mean = motion.mean.copy()
    mean[8, 0] = 100 * SIGMA
    motion = motion._replace(weight=weight, mean=mean)
    P = TRACKER.with_tails(motion, np.zeros((6, 6)))
    away = 100 * SIGMA * 0.999 + native.tail_sigmas(0.001, 2e-5) * SIGMA
    assert P[0, 0] == pytest.approx((away / WRONG_SIGMAS) ** 2)
    assert native.tail_sigmas(4e-5, 2e-5) == 0
    assert native.tail_sigmas(1e-3, 2e-5) == pytest.approx(np.sqrt(2 * np.log(25)))


def test_what_a_covariance_lacks_makes_an_error_as_probable_as_it_is():
    P, error = np.diag([1.0, 2.0, 3.0]), np.array([30.0, -10.0, 5.0])
    probability = 0.05
    whole = P + native.covariance_deficit(P, error, 0.0, probability)
    most = WRONG_SIGMAS - np.sqrt(2 * np.log(probability / 2e-3))
    assert error @ np.linalg.solve(whole, error) == pytest.approx(most ** 2)
    assert not native.covariance_deficit(P, error / 100, 0.0, probability).any()
    assert not native.covariance_deficit(P, error, 0.0, 1e-4).any()


# --- the state, and gyros ---


@pytest.mark.parametrize('size', [3, 6])
def test_a_state_is_updated_as_by_the_textbook(size):
    rng = np.random.default_rng(size)
    root = rng.standard_normal((9, 9))
    P, R = 1e-6 * root @ root.T, np.diag(rng.uniform(1, 2, size)) * 1e-7
    z, state = 1e-4 * rng.standard_normal(size), native.empty_state()._replace(
        quaternion=np.array([0.0, 0.6, 0.0, 0.8]), covariance=P)
    after = native.with_measured(state, np.linalg.inv(R), np.linalg.solve(R, z))
    H = np.eye(size, 9)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    same_covariance(after.covariance, P - K @ H @ P, 1e-9)
    change = np.r_[rotation_between(state.quaternion, after.quaternion), after.rate, after.drift]
    close(change, K @ z, 1e-6, 1e-9)
    # A singular information measures what it measures.
    y = np.zeros((3, 3))
    y[0, 0] = 1e7
    again = native.with_measured(state, y, np.zeros(3)).covariance
    assert again[0, 0] == pytest.approx(1 / (1 / P[0, 0] + 1e7), rel=1e-9)


def test_a_new_drift_is_uncorrelated():
    P = np.ones((9, 9)) + np.eye(9)
    state = native.with_new_drift(native.empty_state()._replace(
        drift=np.ones(3), covariance=P), 0.1)
    assert not state.drift.any() and (state.covariance[:6, :6] == P[:6, :6]).all()
    close(state.covariance[6:], np.hstack([np.zeros((3, 6)), 0.01 * np.eye(3)]))


def gyro_of(stamps_s, rates, options=(3.0, 0.15, 100.0, 0.1), capacity=100):
    return native.Gyro(np.array(options), np.round(np.array(stamps_s) * 1e9), rates, capacity)


def test_a_gyro_has_the_errors_of_its_options():
    model = gyro_of([], np.empty((0, 3))).model
    drift = np.radians(3.0 / 3600)
    close(model, [drift, drift ** 2 / 3600, np.radians(0.15 / 60) ** 2, np.radians(0.1),
                  0.999 * np.radians(100.0)])


def test_a_gyro_rejects_what_is_not_a_rate_and_knows_when_it_was_saturated():
    rates = np.zeros((4, 3))
    rates[1, 2], rates[2, 0] = np.nan, -np.radians(99.95)
    gyro = gyro_of([1, 2, 3, 4], rates)
    assert len(gyro) == 2 and gyro.silent_s(4_500_000_000) == pytest.approx(0.5)
    assert gyro.is_saturated(3_500_000_000, 0.5) and not gyro.is_saturated(3_500_000_001, 0.5)
    assert not gyro.is_saturated(2_999_999_999, 0.5)
    assert gyro_of([], np.empty((0, 3))).silent_s(0) == np.inf


@pytest.mark.parametrize('late_s', [0.0, 0.2])
def test_a_mean_rate_has_its_variance_where_rates_end_before_a_frame(late_s):
    """Means over 10 ms, of which the last one stands for all that are late."""
    rng, rate = np.random.default_rng(4), np.radians([0.3, -0.8, 0.5])
    stamps_ns = np.arange(1, 101 - round(100 * late_s)) * 10 ** 7
    sigma, means = np.radians(0.15 / 60) / np.sqrt(0.01), []
    for _ in range(200):
        gyro = native.Gyro(np.array([0.001, 0.15, 100.0, 0.0]), stamps_ns,
                           rate + rng.normal(0, sigma, (len(stamps_ns), 3)))
        mean, variance = gyro.mean_rate(750_000_000, 10 ** 9)
        means.append((mean - rate) @ (mean - rate) / variance)
    # 99.8 % of 600 chi-squares of one degree.
    assert 3 * abs(np.mean(means) / 3 - 1) < 3 * 3.1 * np.sqrt(2 / 600)


def test_a_full_ring_has_the_newest_rates():
    rng = np.random.default_rng(8)
    stamps = np.cumsum(rng.uniform(0.01, 0.02, 50))
    rates = rng.standard_normal((50, 3)) * 0.01
    whole, ring = gyro_of(stamps, rates), gyro_of(stamps, rates, capacity=20)
    assert len(ring) == 20
    state = native.empty_state()._replace(
        stamp_ns=round(stamps[35] * 1e9), quaternion=np.array([0.0, 0.0, 0.0, 1.0]))
    to_ns = round(stamps[-1] * 1e9) + 5_000_000
    assert all(np.array_equal(one, other) for one, other in zip(
        whole.propagate(state, to_ns), ring.propagate(state, to_ns)))
    for one, other in zip(whole.rates(state.stamp_ns, to_ns), ring.rates(state.stamp_ns, to_ns)):
        assert np.array_equal(one, other)
    # Without a rate of its time the nearest one is used, and the variance grows.
    early = state._replace(stamp_ns=round(stamps[20] * 1e9))
    assert (np.diag(ring.propagate(early, to_ns).covariance)[0]
            > np.diag(whole.propagate(early, to_ns).covariance)[0])


def test_rates_that_come_late_are_used_by_the_next_prediction():
    rng = np.random.default_rng(9)
    stamps, rates = np.arange(1, 31) * 0.01, rng.standard_normal((30, 3)) * 0.01
    state = native.empty_state()._replace(quaternion=np.array([0.0, 0.0, 0.0, 1.0]))
    early, late = gyro_of(stamps[:20], rates[:20]), gyro_of(stamps, rates)
    before, predicted = early.predict(state, 300_000_000)
    assert before.stamp_ns == 200_000_000 and predicted.stamp_ns == 300_000_000
    _, after = late.predict(before, 300_000_000)
    same_state(after, late.propagate(state, 300_000_000), SOLVED)


def test_a_covariance_is_carried_by_the_jacobian_of_the_gyro():
    """P <- Phi P Phi^T + Q: of a gyro without noise Phi is that of differences."""
    rng = np.random.default_rng(10)
    root = 1e-3 * rng.standard_normal((9, 9))
    gyro = gyro_of([0.1], rng.standard_normal((1, 3)) * 0.3, (1e-6, 0.0, 100.0, 0.0))
    state = native.empty_state()._replace(
        quaternion=np.array([0.0, 0.6, 0.0, 0.8]), covariance=root @ root.T)

    def end(x):
        moved = gyro.propagate(state._replace(
            quaternion=turned(state.quaternion, x[:3]), drift=x[6:], rate=x[3:6]), 100_000_000)
        return moved.quaternion, np.r_[moved.rate, moved.drift]

    middle, _ = end(np.zeros(9))
    Phi = np.empty((9, 9))
    for k in range(9):
        above, below = (end(sign * 1e-5 * np.eye(9)[k]) for sign in (1, -1))
        Phi[:3, k] = (rotation_between(middle, above[0]) - rotation_between(middle, below[0]))
        Phi[3:, k] = above[1] - below[1]
    Phi /= 2e-5
    # That of the drift about axes that turn meanwhile is taken at their end.
    same_covariance(gyro.propagate(state, 100_000_000).covariance,
                    Phi @ root @ root.T @ Phi.T, 2e-2)
