# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The fusion of heads of the native core: as recorded (fusion.npz), and by properties.

Of a scene fusion.npz has options, mounts (N, 4), events (E, 3) of kind (0 rate, 1 frame, 2
temperature), head and stamp, numbers of these; of each frame valid (F,), states (F, N) and codes
(F, 2 + N); of one in EACH fused (G, 37); counts (N, 6) at the end and steps (S, 8).
"""

from functools import cache

import native_filter
from native_filter import HEADS, MODES, State
import native_fusion as native
from native_fusion import defaults, Fusion, mounts_of
import numpy as np
import pytest
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_axes, quaternion_from_rotation_vector,
    rotation_vector_from_quaternion)
from startracker_ros.core.native import FUSED, HEAD

ARCSEC = np.pi / 648000
OF_SIGMA = 5e-9  # of a record: after hundreds of frames, each with what rounding left
OPTIONS = ('start_heads', 'agree_frames', 'exclude_frames', 'horizon_s', 'max_gap_s',
           'max_gyro_gap_s', 'acceleration_deg_s2', 'correlation_s', 'mount_sigma_arcsec',
           'mount_walk_arcsec_sqrt_h', 'mount_temperature_arcsec_k', 'mount_orbit_arcsec',
           'orbit_period_s', 'gyro_drift_deg_h', 'gyro_noise_deg_sqrt_h', 'gyro_range_deg_s',
           'gyro_rate_change_deg_s2')
SCENES = ('late', 'no_gyro', 'law', 'jump', 'mount', 'stamps', 'one_head', 'noise', 'noise_of_two',
          'gyro_axes', 'gyro_scale')
EACH = 7
START_NS = 1_784_000_000 * 10 ** 9
COVARIANCE = np.diag([1.0, 1.0, 100.0]) * ARCSEC ** 2
RATE = np.radians([0.05, -0.06, 0.03])
Q0 = np.array([0.5, -0.1, 0.7, np.sqrt(1 - 0.75)])
REASONS = {'waiting': 700, 'no pair': 701, 'disagree': 702, 'none left': 704,
           'repeats': 721, 'late': 722, 'ahead': 723, 'ahead of gyro': 724, 'gyro behind': 740}


def turned(q, rotation):
    return multiply(q, quaternion_from_rotation_vector(rotation))


def error_of(q, truth):
    return rotation_vector_from_quaternion(multiply(conjugate(truth), q))


# --- the record ---


@cache
def archive():
    with np.load(native.RECORD) as file:
        return dict(file)


@pytest.mark.parametrize('scene', SCENES)
def test_a_scene_gives_what_it_gave_in_the_record(scene):
    record = {key.partition(' ')[2]: value for key, value in archive().items()
              if key.startswith(f'{scene} ')}
    mounts = mounts_of(record['mounts'])
    fusion = Fusion(defaults(len(mounts), **dict(zip(OPTIONS, record['options']))), mounts)
    numbers, frame, fused, steps = record['numbers'], 0, iter(record['fused']), []
    for kind, head, stamp_ns in record['events'].tolist():
        given, numbers = np.split(numbers, [(3, 13, 1)[kind]])
        if kind == 0:
            fusion.add_rate(stamp_ns, given)
            continue
        if kind == 2:
            assert fusion.add_temperature(head, given[0])
            continue
        found = fusion.add_frame(head, stamp_ns, given[:4], given[4:])
        assert (found is not None) == record['valid'][frame], frame
        states = [fusion.head(number) for number in range(len(mounts))]
        assert [one['state'] for one in states] == record['states'][frame].tolist()
        assert [fusion.trouble['code'], fusion.gyro_trouble['code'], *(
            one['reason']['code'] for one in states)] == record['codes'][frame].tolist(), frame
        steps += list(fusion.steps)
        frame += 1
        if found is not None and frame % EACH == 0:
            expected = dict(zip(FUSED.names, np.split(
                next(fused), np.cumsum([4, 9, 3, 9, 3])), strict=False))
            assert found['quaternion'] @ expected['quaternion'] > 0
            turn = error_of(found['quaternion'], expected['quaternion'])
            for value, mean, covariance in (
                    (turn, np.zeros(3), 'covariance_rad2'),
                    (found['rate_rad_s'], expected['rate_rad_s'], 'rate_covariance'),
                    (found['drift_rad_s'], expected['drift_rad_s'], 'drift_covariance')):
                P = expected[covariance].reshape(3, 3)
                sigma = np.sqrt(np.diag(P))
                assert (np.abs(value - mean) <= OF_SIGMA * sigma).all()
                assert (np.abs(found[covariance] - P) <= OF_SIGMA * np.outer(sigma, sigma)).all()
    assert next(fused, None) is None and len(steps) == len(record['steps'])
    counts = [[one[name] for name in ('used', 'repeated', 'late', 'ahead', 'disagreeing',
                                      'not_counted_yet')] for one in states]
    assert counts == record['counts'].tolist()


# --- heads without noise ---


class Heads:
    """Heads on a body at a constant rate, frames every 0.2 s."""

    def __init__(self, count=3, start_ns=START_NS, **options):
        axes = np.eye(3)[[2, 0, 1]][:count]
        self.mounts = [quaternion_from_axes(z, np.roll(z, 1)) for z in axes]
        self.fusion = Fusion(defaults(count, **options), mounts_of(self.mounts))
        self.time_s, self.start_ns, self.covariance = 0.0, start_ns, COVARIANCE

    def frame(self, head, time_s, error=np.zeros(3), stamp_s=None):
        q = turned(turned(Q0, RATE * time_s), np.asarray(error, float))
        return self.fusion.add_frame(
            head, self.stamp(time_s if stamp_s is None else stamp_s),
            multiply(q, self.mounts[head]), self.covariance)

    def stamp(self, time_s):
        return self.start_ns + round(time_s * 1e9)

    def run(self, frames, heads=None, errors=None):
        results = []
        for _ in range(frames):
            self.time_s += 0.2
            for head in range(len(self.mounts)) if heads is None else heads:
                results.append(self.frame(head, self.time_s + 0.01 * head,
                                          (errors or {}).get(head, np.zeros(3))))
        return results

    def error_arcsec(self, result):
        time_s = (int(result['stamp_ns']) - self.start_ns) * 1e-9
        return np.linalg.norm(error_of(result['quaternion'], turned(Q0, RATE * time_s))) / ARCSEC


def test_heads_that_agree_give_the_attitude_of_the_body():
    heads = Heads()
    results = heads.run(20)
    assert [heads.fusion.state(head) for head in range(3)] == ['used'] * 3
    assert heads.error_arcsec(results[-1]) < 0.01
    np.testing.assert_allclose(results[-1]['rate_rad_s'], RATE, atol=0.1 * ARCSEC)
    assert heads.fusion.trouble['code'] == 0
    for whole in (results[-1]['covariance_rad2'], results[-1]['rate_covariance']):
        assert (whole == whole.T).all()
        np.linalg.cholesky(whole)


def test_two_heads_that_disagree_give_nothing():
    heads = Heads(2)
    assert not any(result is not None for result in heads.run(
        20, errors={1: np.radians([0.6, 0.8, 0.0])}))
    trouble = heads.fusion.trouble
    assert trouble['code'] == REASONS['disagree']
    assert trouble['figure'][:3] == pytest.approx([0, 1, 1.0], abs=1e-3)


def test_a_wrong_head_is_excluded_and_counts_again_after_it_has_agreed():
    heads = Heads()
    heads.run(10)
    heads.run(5, errors={2: [0.0, 1e-3, 0.0]})
    assert heads.fusion.state(2) == 'excluded'
    assert heads.fusion.head(2)['reason']['figure'][0] == pytest.approx(np.degrees(1e-3), rel=0.01)
    heads.run(4)
    assert heads.fusion.state(2) == 'excluded'
    heads.run(1)
    assert heads.fusion.state(2) == 'used'


def test_frames_in_any_order_give_the_same_attitude():
    found = []
    for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)):
        heads = Heads()
        heads.run(10)
        for head in order:
            heads.frame(head, 2.3 + 0.03 * head, 2 * ARCSEC * np.array([1, -1, head]))
        found.append(heads.frame(0, 2.5))
    for one in found[1:]:
        np.testing.assert_allclose(one['quaternion'], found[0]['quaternion'], atol=1e-13)
        np.testing.assert_allclose(one['covariance_rad2'], found[0]['covariance_rad2'], rtol=1e-6)


def test_frames_beyond_the_capacity_are_forgotten_the_oldest_first():
    few, many = Heads(frames=4), Heads()
    for heads in (few, many):
        heads.run(10)
    # Late by more than four frames, but within the horizon.
    assert many.frame(0, many.time_s - 0.5) is None and many.fusion.head(0)['late'] == 0
    assert few.frame(0, few.time_s - 0.5) is None and few.fusion.head(0)['late'] == 1
    assert few.fusion.bytes < many.fusion.bytes
    results = few.run(20)
    assert few.error_arcsec(results[-1]) < 0.01


def test_a_reset_forgets_all_frames():
    heads = Heads()
    first = heads.run(20)
    heads.fusion.reset()
    assert heads.fusion.trouble['code'] == REASONS['waiting']
    heads.time_s = 0.0
    again = heads.run(20)
    for one, other in zip(first, again):
        assert (one is None) == (other is None)
        if one is not None:
            assert np.array_equal(one['covariance_rad2'], other['covariance_rad2'])
            assert np.abs(one['quaternion'] @ other['quaternion']) == pytest.approx(1, abs=1e-15)


def test_late_and_repeated_frames_are_named():
    heads = Heads()
    heads.run(10)
    assert heads.frame(0, heads.time_s) is None
    assert heads.fusion.head(0)['reason']['code'] == REASONS['repeats']
    assert heads.frame(2, heads.time_s, stamp_s=heads.time_s - 2.0) is None
    reason = heads.fusion.head(2)['reason']
    assert reason['code'] == REASONS['late']
    assert reason['figure'][0] == pytest.approx(2.02, abs=1e-6)


def test_one_head_alone_does_not_start_but_carries_on():
    heads = Heads(2)
    assert all(result is None for result in heads.run(10, heads=[0]))
    assert heads.fusion.trouble['code'] == REASONS['no pair']
    heads.run(10)
    results = heads.run(50, heads=[0])
    assert all(result is not None for result in results)
    assert heads.error_arcsec(results[-1]) < 0.1


def test_after_darkness_of_all_a_single_head_is_not_enough():
    heads = Heads(2)
    heads.run(10)
    heads.time_s += 5.0
    results = heads.run(10, heads=[0], errors={0: [0.0, 0.0, 2e-3]})
    assert all(result is None for result in results)
    assert any(result is not None for result in heads.run(3))


def test_a_head_alone_that_disagrees_with_the_prediction_is_named():
    heads = Heads(2)
    heads.run(10)
    heads.run(8, heads=[0])
    for sign in (1, -1, 1, -1):
        assert heads.run(1, heads=[0], errors={0: [sign * 1.0, 0.0, 0.0]}) == [None]
    trouble = heads.fusion.trouble
    assert trouble['code'] == REASONS['none left'] and trouble['figure'][0] == 0
    assert trouble['figure'][1] == pytest.approx(np.degrees(1.0), rel=0.1)
    assert heads.fusion.state(0) == 'excluded'


def with_gyro(heads, frames, late_ticks=0, wrong=None):
    """Run frames with four rates in each, and yield the results."""
    for _ in range(frames):
        for tick in range(1, 5):
            heads.fusion.add_rate(heads.stamp(heads.time_s + 0.05 * (tick - late_ticks)), RATE)
        yield heads.run(1)


def test_a_gyro_that_agrees_is_used_and_one_that_comes_late_is_named():
    heads = Heads(2)
    results = list(with_gyro(heads, 20))
    assert heads.fusion.uses_gyro and heads.fusion.gyro_trouble['code'] == 0
    assert heads.error_arcsec(results[-1][-1]) < 0.1
    late = Heads(2)
    list(with_gyro(late, 20, late_ticks=8))
    assert not late.fusion.uses_gyro
    assert late.fusion.gyro_trouble['code'] == REASONS['gyro behind']
    assert late.fusion.gyro_trouble['figure'][0] == pytest.approx(0.41, abs=1e-6)


def test_frames_ahead_of_the_others_and_of_the_gyro_are_named():
    heads = Heads(3)
    heads.run(10)
    for _ in range(10):
        assert heads.frame(2, heads.time_s, stamp_s=heads.time_s + 3600) is None
        heads.time_s += 0.01
        assert all(result is not None for result in heads.run(1, heads=[0, 1]))
    assert heads.fusion.head(2)['reason']['code'] == REASONS['ahead']
    heads = Heads(3)
    list(with_gyro(heads, 20))
    assert heads.frame(1, heads.time_s, stamp_s=heads.time_s + 0.7) is None
    assert heads.fusion.head(1)['reason']['code'] == REASONS['ahead of gyro']


def test_the_velocity_of_an_unknown_date_does_not_average_out():
    wide = COVARIANCE + np.diag([12.3, 12.3, 1.0]) ** 2 * ARCSEC ** 2
    for covariance, least, most in ((wide, 12, 14), (COVARIANCE, 1, 2)):
        heads = Heads(start_ns=100 * 10 ** 9)
        heads.covariance = covariance
        sigma = np.sqrt(np.diag(heads.run(60)[-1]['covariance_rad2'])) / ARCSEC
        assert least < sigma.min() and sigma.max() < most


def test_what_is_not_an_attitude_is_refused():
    heads, fused = Heads(2), np.zeros((), FUSED)
    good_q, good_P = np.array([0.0, 0.0, 0.0, 1.0]), COVARIANCE
    for q, P in (([0, 0, 0, np.nan], good_P), ([0, 0, 0, 0.9], good_P), (good_q, good_P * np.nan),
                 (good_q, -good_P), (good_q, np.diag([1.0, 1.0, 0.0])),
                 (good_q, np.diag([1.0, -1.0, -1.0]))):
        assert native.call('add_frame', heads.fusion.handle, 0, START_NS, np.array(q, float),
                           np.array(P, float), fused) != 0
    for head in (-1, 2):
        assert native.call('add_frame', heads.fusion.handle, head, START_NS, good_q, good_P,
                           fused) != 0
        assert native.call('head', heads.fusion.handle, head, START_NS,
                           np.zeros((), HEAD)) != 0
    for celsius in (np.nan, 293.15, -300.0):
        assert not heads.fusion.add_temperature(1, celsius)
    assert not heads.fusion.add_rate(START_NS, [np.nan, 0, 0])
    assert not heads.fusion.add_rate(START_NS, [0, 0, np.radians(99.95)])
    assert heads.fusion.add_rate(START_NS, RATE) and not heads.fusion.add_rate(START_NS, RATE)


@pytest.mark.parametrize('seed', range(4))
def test_any_input_does_no_harm(seed):
    """Stamps, attitudes and rates of any size: what comes out is an attitude, or nothing."""
    rng, heads = np.random.default_rng(seed), Heads(3, frames=8, rates=16)
    heads.run(5)
    for _ in range(1500):
        scale = 10.0 ** rng.integers(0, 20)
        stamp_ns = heads.stamp(heads.time_s) + int(
            np.clip(scale * rng.standard_normal(), -9e18, 7e18))
        q, root = rng.standard_normal(4), rng.standard_normal((3, 3))
        P = root @ root.T * 10.0 ** rng.integers(-25, 25)
        fused = np.zeros((), FUSED)
        kind, head = rng.integers(4), int(rng.integers(3))
        if kind == 0:
            heads.fusion.add_rate(stamp_ns, 10.0 ** rng.integers(-9, 3) * rng.standard_normal(3))
        elif kind == 1:
            native.call('add_frame', heads.fusion.handle, head, stamp_ns, q / np.linalg.norm(q),
                        P, fused)
        elif kind == 2:
            heads.fusion.add_temperature(head, 300 * rng.standard_normal())
        else:
            fused = heads.run(1, [head])[0]
        if fused is not None and fused['valid']:
            assert np.isfinite(fused['covariance_rad2']).all()
            np.linalg.cholesky(fused['covariance_rad2'] / np.trace(fused['covariance_rad2']))
        for number in range(3):
            heads.fusion.mount(number, heads.stamp(heads.time_s))
            heads.fusion.estimated(number)


def test_impossible_options_mounts_and_memory_are_refused():
    mounts, size = mounts_of(np.eye(4)[[3, 3, 3]]), np.zeros(1, np.uintp)
    assert native.call('size', defaults(3), mounts, size) == 0
    for wrong in (defaults(0), defaults(14), defaults(3, horizon_s=61.0),
                  defaults(3, agree_frames=0), defaults(3, correlation_s=np.nan)):
        assert native.call('size', wrong, mounts, size) != 0
    many = mounts_of(np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)))
    law = {'mount_temperature_arcsec_k': 1.0, 'mount_orbit_arcsec': 1.0}
    assert native.call('size', defaults(5), many, size) == 0
    assert native.call('size', defaults(5, **law), many, size) != 0, '48 coefficients'
    assert native.call('size', defaults(4, **law), many, size) == 0
    assert native.call('size', defaults(3), mounts_of(np.ones((3, 4))), size) != 0
    config, fault = defaults(2), np.zeros(4)
    assert native.call('size', config, mounts, size) == 0
    memory = np.zeros(int(size[0]) + 128, np.uint8)
    begin, handle = -memory.ctypes.data % 64, np.zeros(1, np.uintp)
    for offset, room in ((begin, int(size[0]) - 1), (begin + 1, int(size[0]) + 60)):
        assert native.call('create', memory[offset:], room, config, mounts, handle, fault) != 0
    assert native.call('create', memory[begin:], int(size[0]), config, mounts, handle, fault) == 0


# --- mounts ---


def test_the_misalignment_is_about_body_axes_and_the_law_of_the_file_counts():
    mount = quaternion_from_axes(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    mounts = mounts_of([mount, mount], temperature_c=20.0)
    mounts[1]['law'], mounts[1]['has_law'] = np.diag([1e-5, 0.0, 0.0]), 1
    mounts[1]['law'][0, 1] = 2e-5
    mounts[1]['law_covariance'], mounts[1]['has_law_covariance'] = np.eye(12) * 1e-14, 1
    fusion = Fusion(defaults(2), mounts)
    assert fusion.head(1)['needs_temperature'] and not fusion.head(0)['needs_temperature']
    assert fusion.add_temperature(1, 30.0) and not fusion.head(1)['needs_temperature']
    q, misalignment, covariance = fusion.mount(1, 0)
    np.testing.assert_allclose(misalignment, [1e-4, 2e-4, 0], atol=1e-15)
    np.testing.assert_allclose(2 * multiply(q, conjugate(mount))[:3], misalignment, atol=1e-10)
    np.testing.assert_allclose(np.diag(covariance), 1e-14 * (1 + 100) * np.ones(3))
    estimated = fusion.estimated(1)
    np.testing.assert_allclose(estimated['law'], mounts[1]['law'])
    # The orbit has no terms here.
    np.testing.assert_allclose(np.diag(estimated['law_covariance']), [1e-14] * 6 + [0.0] * 6)
    assert not fusion.estimated(0)['has_covariance'] and fusion.estimated(0)['quaternion'] == (
        pytest.approx(mount))


def test_a_step_is_found_and_dated_and_slow_bending_is_not_a_step():
    rng, size = np.random.default_rng(8), np.array([3.0, -4.0, 0.0]) * ARCSEC
    tick = np.arange(1200)
    noise = ARCSEC * np.array([1, 1, 11]) * rng.standard_normal((1200, 2, 3))
    bent = np.sin(2 * np.pi * tick / 5700)[:, None] * np.ones(3) * 9 * ARCSEC
    for stepped in (0.0, 1.0):
        offset = noise.copy()
        offset[:, 1] += bent + stepped * size * (tick >= 703)[:, None]
        stamps = (tick[:, None] * 10 ** 9 + [0, 1]).ravel()
        variance = np.broadcast_to((ARCSEC * np.array([1, 1, 11])) ** 2, (2400, 3))
        found = native.find_steps(2, np.tile([0, 1], 1200), stamps, offset.reshape(-1, 3),
                                  variance, np.zeros((2400, 0)))
        assert len(found) == stepped
    step, = found
    assert step['head'] == 1 and abs(step['stamp_ns'] * 1e-9 - 703) <= 20
    # Of the block of the step a part is before it.
    assert (np.abs(step['size_rad'] - size) < 5 * step['sigma_rad'] + 0.1 * np.abs(size)).all()


def test_bending_by_a_known_law_and_noise_that_grows_are_not_steps():
    rng, tick = np.random.default_rng(7), np.arange(1500)
    temperature = 10 * np.sin(2 * np.pi * tick / 600)
    sigma = (ARCSEC * np.array([1, 1, 11])) * np.where(tick % 300 >= 270, 30, 1)[:, None]
    offset = sigma[:, None] * rng.standard_normal((1500, 2, 3))
    offset[:, 1] += 0.9 * ARCSEC * temperature[:, None]
    law = np.repeat(temperature, 2)[:, None]
    assert not len(native.find_steps(
        2, np.tile([0, 1], 1500), np.repeat(tick * 10 ** 9, 2), offset.reshape(-1, 3),
        np.repeat(sigma ** 2, 2, axis=0), law))


# --- the filter with constants ---


def with_constants(count=4):
    """Return a motion of the first mode alone, with so many constants, and their covariance."""
    rng = np.random.default_rng(count)
    root = 1e-5 * rng.standard_normal((9 + count, 9 + count))
    state = State(0, np.array([0.0, 0.6, 0.0, 0.8]), 1e-3 * rng.standard_normal(3),
                  1e-6 * rng.standard_normal(3), root @ root.T)
    constants = 1e-5 * rng.standard_normal(count)
    motion = HEADS.started(state, np.full(3, 1e-12), 0.1, constants)
    one = np.eye(MODES)[0]
    return motion._replace(weight=one, share=one), state, constants


def test_constants_go_with_a_motion():
    motion, state, constants = with_constants()
    found, same = HEADS.state_and_constants(motion)
    np.testing.assert_allclose(same, constants, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, state.covariance, rtol=1e-12, atol=1e-25)
    walk = np.r_[np.full(3, 1e-18), np.arange(1, 5) * 1e-12]
    after = HEADS.predicted(motion, 100_000_000, np.array([0.1]), np.empty((0, 3)), np.empty(0),
                            np.zeros(3), walk)
    grown = HEADS.state_of(after).covariance[9:, 9:] - state.covariance[9:, 9:]
    np.testing.assert_allclose(grown, np.diag(walk[3:] * 0.1), rtol=1e-6, atol=1e-24)
    _, same = HEADS.state_and_constants(after)
    np.testing.assert_allclose(same, constants, rtol=1e-9)
    moved = state._replace(stamp_ns=5, covariance=4 * state.covariance)
    again, same = HEADS.state_and_constants(HEADS.restarted(after, moved))
    np.testing.assert_allclose(same, constants, rtol=1e-9)
    np.testing.assert_allclose(again.covariance, moved.covariance, rtol=1e-12, atol=1e-25)


def test_constants_are_measured_by_the_textbook():
    motion, _, constants = with_constants()
    rng, P = np.random.default_rng(2), motion.covariance[0]
    R, z = np.diag([1.0, 2.0, 3.0]) * 1e-10, 1e-5 * rng.standard_normal(3)
    H, Y = np.zeros((3, 16)), np.linalg.inv(R)
    H[:, :3], H[:, 13:16] = np.eye(3), rng.standard_normal((3, 3))
    assumed = H[:, 12:] @ constants
    after = HEADS.updated(motion, motion.quaternion, np.zeros(3), Y, Y @ z, H[:, 6:], assumed)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    native_P = after.covariance[0]
    sigma = np.sqrt(np.diag(P)) + 1e-30
    assert (np.abs(native_P - (P - K @ H @ P)) <= 1e-9 * np.outer(sigma, sigma)).all()
    np.testing.assert_allclose(after.mean[0, 12:] - constants, (K @ z)[12:], rtol=1e-6)
    turn = error_of(after.quaternion, motion.quaternion) + after.mean[0, :3]
    np.testing.assert_allclose(turn, (K @ z)[:3], rtol=1e-5, atol=1e-14)


def test_a_gyro_turns_the_covariance_of_constants_too():
    _, state, _ = with_constants()
    gyro = native_filter.Gyro(np.array([1e-6, 0.0, 100.0, 0.0]), [50_000_000, 100_000_000],
                              [[0.1, 0.2, -0.1], [0.1, 0.2, -0.1]])
    after = gyro.propagate(state, 100_000_000)
    assert np.array_equal(after.covariance[9:, 9:], state.covariance[9:, 9:])
    alone = gyro.propagate(state._replace(covariance=state.covariance[:9, :9]), 100_000_000)
    assert np.array_equal(after.covariance[:9, :9], alone.covariance)
    turn = multiply(conjugate(state.quaternion), after.quaternion)
    v = state.covariance[:3, 9] - 0.1 * state.covariance[6:9, 9]
    np.testing.assert_allclose(np.linalg.norm(after.covariance[:3, 9]), np.linalg.norm(v),
                               rtol=0.05)
    assert np.linalg.norm(turn[:3]) > 0
