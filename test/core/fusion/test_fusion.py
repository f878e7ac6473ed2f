# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Several heads, one attitude: late frames, disagreement, exclusion and return, bad input."""

import itertools

from chi_square import check_mean
import numpy as np
import pytest
from startracker_evaluation.campaign.heads_scene import (
    errors_of, head_mounts, NAMES, Scene, SceneRun, START_NS, UNDERSTATED, UNDERSTATED_BY,
    WRONG_GYROS)
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.head import HeadFrame, HeadState
from startracker_ros.core.fusion.mounts import Mount, MountOptions
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, conjugate, multiply, quaternion_from_rotation_vector, turned)
from startracker_ros.tools.figures.correctness import count_wrong, nees_of

KNOWN = MountOptions(mount_sigma_arcsec=0.0, mount_walk_arcsec_sqrt_h=0.0)
COVARIANCE = np.diag([1.0, 1.0, 100.0]) * ARCSEC ** 2
RATE = np.radians([0.05, -0.06, 0.03])
Q0 = np.array([0.5, -0.1, 0.7, np.sqrt(1 - 0.75)])


class Heads:
    """Heads without noise on a body at a constant rate, frames every 0.2 s."""

    def __init__(self, count=3, options=FusionOptions(), mount_options=MountOptions(),
                 gyro_options=GyroErrorOptions()):
        self.mounts = head_mounts(count)
        self.names = NAMES[:count]
        self.fusion = AttitudeFusion(
            {name: Mount(q) for name, q in zip(self.names, self.mounts)}, options, mount_options,
            gyro_options)
        self.time_s = 0.0
        self.start_ns, self.covariance = START_NS, COVARIANCE

    def truth(self, time_s):
        return turned(Q0, RATE * time_s)

    def frame(self, head, time_s, error=np.zeros(3), stamp_s=None):
        q = turned(turned(self.truth(time_s), np.asarray(error, float)), np.zeros(3))
        stamp_ns = self.start_ns + round((time_s if stamp_s is None else stamp_s) * 1e9)
        return self.fusion.add_frame(self.names[head], HeadFrame(
            stamp_ns, multiply(q, self.mounts[head]), self.covariance))

    def run(self, frames, heads=None, errors=None):
        """Feed so many frames of each head; return the last attitude of each of its frames."""
        results = []
        for _ in range(frames):
            self.time_s += 0.2
            for head in range(len(self.names)) if heads is None else heads:
                error = (errors or {}).get(head, np.zeros(3))
                results.append(self.frame(head, self.time_s + 0.01 * head, error))
        return results

    def state(self, head):
        return self.fusion.heads[self.names[head]].state

    def error_arcsec(self, result):
        time_s = (result.stamp_ns - self.start_ns) * 1e-9
        return np.linalg.norm(attitude_error(result.quaternion, self.truth(time_s))) / ARCSEC


def test_heads_that_agree_give_the_attitude_of_the_body():
    heads = Heads()
    results = heads.run(20)
    assert all(heads.state(head) is HeadState.USED for head in range(3))
    assert heads.error_arcsec(results[-1]) < 0.01
    np.testing.assert_allclose(results[-1].rate_rad_s, RATE, atol=0.1 * ARCSEC)
    assert results[-1].quaternion @ results[-2].quaternion > 0


@pytest.mark.parametrize('covariance, least, most', [
    (COVARIANCE + np.diag([12.3, 12.3, 1.0]) ** 2 * ARCSEC ** 2, 12, 14), (COVARIANCE, 1, 2)])
def test_the_velocity_of_an_unknown_date_does_not_average_out(covariance, least, most):
    """All heads have its error in common, in all frames; without aberration it is small."""
    heads = Heads()
    heads.start_ns, heads.covariance = 100 * 10 ** 9, covariance
    error = np.array([20.5, 0.0, 0.0]) * ARCSEC * (most > 10)
    result = heads.run(60, errors=dict.fromkeys(range(3), error))[-1]
    sigma_arcsec = np.sqrt(np.diag(result.covariance)) / ARCSEC
    assert heads.error_arcsec(result) < 2 * sigma_arcsec[0]
    assert least < sigma_arcsec.min() and sigma_arcsec.max() < most


def test_frames_in_any_order_give_the_same_state():
    # Each head has a frame at another time; the last three of one block in all orders.
    states = []
    for order in itertools.permutations(range(3)):
        heads = Heads()
        heads.run(10)
        for head in order:
            heads.frame(head, 2.3 + 0.03 * head, 2 * ARCSEC * np.array([1, -1, head]))
        states.append(heads.frame(0, 2.5))
    for state in states[1:]:
        np.testing.assert_allclose(state.quaternion, states[0].quaternion, atol=1e-13)
        np.testing.assert_allclose(state.covariance, states[0].covariance, rtol=1e-6, atol=1e-18)


def test_two_heads_that_disagree_give_nothing_and_are_named():
    heads = Heads(2)
    assert not any(heads.run(20, errors={1: np.radians([0.6, 0.8, 0.0])}))
    assert 'head_1 and head_2 disagree by 1 deg' in heads.fusion.trouble.replace(
        'head_2 and head_1', 'head_1 and head_2')


def test_of_three_the_two_that_agree_count():
    for wrong in range(3):
        heads = Heads()
        results = heads.run(20, errors={wrong: np.radians([0.6, 0.8, 0.0])})
        assert heads.state(wrong) is HeadState.EXCLUDED
        assert '1 deg from' in heads.fusion.heads[NAMES[wrong]].reason
        # The mounts of the others are uncertain by their sigma, and are not here.
        assert heads.error_arcsec([result for result in results if result][-1]) < 0.1


def test_a_head_is_excluded_named_and_counted_again_after_it_has_agreed():
    heads = Heads()
    heads.run(10)
    heads.run(2, errors={2: [0.0, 1e-3, 0.0]})
    # A single frame that disagrees is left out.
    assert heads.state(2) is HeadState.USED
    heads.run(5, errors={2: [0.0, 1e-3, 0.0]})
    assert heads.state(2) is HeadState.EXCLUDED
    heads.run(FusionOptions().agree_frames - 1)
    assert heads.state(2) is HeadState.EXCLUDED
    heads.run(1)
    assert heads.state(2) is HeadState.USED


def test_two_heads_and_the_prediction_decide_which_one_is_wrong():
    heads = Heads(2)
    heads.run(10)
    results = heads.run(10, errors={0: [1e-3, 0.0, 0.0]})
    assert (heads.state(0), heads.state(1)) == (HeadState.EXCLUDED, HeadState.USED)
    assert all(heads.error_arcsec(result) < 0.1 for result in results if result)


@pytest.mark.parametrize('convention', [
    conjugate, lambda q: q[[3, 0, 1, 2]], lambda q: q * [-1, 1, -1, 1],
    lambda q: multiply(q, conjugate(head_mounts()[2])),
    lambda q: multiply(quaternion_from_rotation_vector([0, 0, np.radians(0.3)]), q)],
    ids=['conjugate', 'w first', 'mirrored', 'of the body', 'of another inertial frame'])
def test_attitudes_of_another_convention_are_named_and_the_others_go_on(convention):
    heads = Heads()
    heads.run(10)
    for _ in range(10):
        results = heads.run(1, heads=[0, 1])
        q = convention(multiply(heads.truth(heads.time_s + 0.02), heads.mounts[2]))
        assert heads.fusion.add_frame(NAMES[2], HeadFrame(
            START_NS + round((heads.time_s + 0.02) * 1e9), q, COVARIANCE)) is None
        assert all(heads.error_arcsec(result) < 0.1 for result in results)
    assert heads.state(2) is HeadState.EXCLUDED
    assert 'deg from what other heads' in heads.fusion.heads[NAMES[2]].reason


def test_a_head_whose_clock_begins_anew_is_named_and_counts_again_when_it_is_set():
    heads = Heads()
    heads.run(10)
    for index in range(5):
        assert all(heads.run(1, heads=[0, 1]))
        assert heads.frame(2, heads.time_s, stamp_s=-1e6 + 0.2 * index) is None
    assert 'behind the other heads' in heads.fusion.heads[NAMES[2]].reason
    heads.run(FusionOptions().agree_frames + 1)
    assert heads.state(2) is HeadState.USED


def test_a_manoeuvre_that_two_heads_see_is_followed_without_a_gyro():
    heads = Heads(3)
    heads.run(10)
    before = heads.truth
    heads.truth = lambda time_s: turned(before(time_s), np.radians(
        [0.0, 0.0, 0.5 * max(0.0, time_s - 2.0)]))
    results = heads.run(10)
    assert heads.error_arcsec(results[-1]) < 1.0
    assert all(heads.state(head) is HeadState.USED for head in range(3))


def test_one_head_alone_does_not_start_but_carries_on():
    heads = Heads(2)
    assert not any(heads.run(10, heads=[0]))
    assert heads.fusion.trouble == 'no frames of two heads at a time'
    heads.run(10)
    results = heads.run(50, heads=[0])
    assert all(results) and heads.error_arcsec(results[-1]) < 0.1
    assert all(Heads(1).run(10)[1:])


def test_after_darkness_of_all_a_single_head_is_not_enough():
    heads = Heads(2)
    heads.run(10)
    heads.time_s += 5.0
    assert not any(heads.run(10, heads=[0], errors={0: [0.0, 0.0, 2e-3]}))
    assert any(heads.run(3))


@pytest.mark.parametrize('wrong', ['degrees', 'swapped'])
def test_a_wrong_gyro_is_named_and_the_heads_go_on(wrong):
    heads = Heads(2)
    rate = np.degrees(RATE) if wrong == 'degrees' else RATE[[1, 2, 0]]
    for index in range(100):
        heads.fusion.add_rate(START_NS + round((index + 1) * 0.05 * 1e9), rate)
        if index % 4 == 3:
            results = heads.run(1)
    assert 'imu reports' in heads.fusion.gyro_trouble
    assert heads.error_arcsec(results[-1]) < 0.1


def test_a_gyro_that_was_wrong_is_used_late_after_a_restart_too():
    heads = Heads(2)
    fusion = heads.fusion

    def used_after(rate, frames=60):
        for index in range(4 * frames):
            heads.fusion.add_rate(START_NS + round((heads.time_s + index % 4 * 0.05) * 1e9), rate)
            if index % 4 == 3:
                heads.run(1)
                if fusion.uses_gyro:
                    return index // 4
        return None
    assert used_after(RATE) < 15
    while fusion.uses_gyro:
        used_after(2 * RATE, 1)
    assert 'not with imu' in fusion.gyro_trouble
    heads.time_s += 5.0
    assert 29 <= used_after(RATE) < 50


def test_late_repeated_and_future_frames_are_named_and_the_others_go_on():
    heads = Heads(3)
    heads.run(10)
    for _ in range(10):
        heads.run(1, heads=[0, 1])
        assert heads.frame(2, heads.time_s, stamp_s=heads.time_s - 2.0) is None
    assert heads.fusion.heads['head_3'].counts['late'] == 10
    assert '2.0 s behind the other heads' in heads.fusion.heads['head_3'].reason
    # The oldest frame is in use still: the same stamp again changes nothing.
    assert heads.frame(0, heads.time_s, [1e-5, 0, 0]) is None
    assert heads.fusion.heads['head_1'].counts['repeated stamps'] == 1
    assert heads.error_arcsec(heads.run(1, heads=[0])[-1]) < 0.01
    for _ in range(10):
        assert heads.frame(2, heads.time_s, stamp_s=heads.time_s + 3600) is None
        heads.time_s += 0.01
        assert all(heads.run(1, heads=[0, 1]))
    assert '3600' in heads.fusion.heads['head_3'].reason


def test_a_clock_that_is_ahead_of_the_gyro_decides_nothing_alone():
    # Beyond the newest rate the prediction is too uncertain to reject what is wrong.
    heads = Heads(3)
    results = []
    for index in range(400):
        heads.fusion.add_rate(START_NS + round((index + 1) * 0.05 * 1e9), RATE)
        if index % 4 == 3:
            late = index > 200
            results += [heads.run(1, heads=[0, 2] if late else None)[-1]]
            if late:
                results += [heads.frame(1, heads.time_s, stamp_s=heads.time_s + 0.7)]
    assert heads.fusion.uses_gyro
    assert heads.fusion.heads['head_2'].counts['ahead'] > 40
    assert 'ahead of imu' in heads.fusion.heads['head_2'].reason
    assert heads.state(0) is heads.state(2) is HeadState.USED
    assert max(heads.error_arcsec(result) for result in results if result) < 0.1


def test_a_gyro_that_comes_too_late_is_named_and_not_used():
    heads, results = Heads(2), []
    for index in range(80):
        if index > 8:
            heads.fusion.add_rate(START_NS + round((index - 7) * 0.05 * 1e9), RATE)
        if index % 4 == 3:
            results += heads.run(1)
    assert not heads.fusion.uses_gyro and all(results[3:])
    assert heads.fusion.gyro_trouble == 'imu is 0.41 s behind the heads'


def test_heads_go_on_when_the_gyro_ends():
    heads, results = Heads(2), []
    for index in range(120):
        if index < 60:
            heads.fusion.add_rate(START_NS + round((index + 1) * 0.05 * 1e9), RATE)
        if index % 4 == 3:
            results += heads.run(1)
    assert heads.fusion.uses_gyro is False
    # The frames of at most a second are lost.
    assert sum(result is None for result in results) <= 10 and all(results[-20:])
    assert max(heads.error_arcsec(result) for result in results if result) < 0.1


def test_an_hour_in_which_all_are_blinded_is_not_an_error_of_the_gyro():
    heads, results = Heads(2), []
    for index in range(80):
        heads.time_s += 3600.0 * (index == 40)
        for tick in range(4):
            heads.fusion.add_rate(START_NS + round((heads.time_s + 0.05 * (tick + 1)) * 1e9), RATE)
        results += heads.run(1)
        assert not heads.fusion.gyro_trouble
    assert heads.fusion.uses_gyro and all(results[-60:])
    assert max(heads.error_arcsec(result) for result in results if result) < 0.1


def test_the_sign_of_a_quaternion_means_nothing():
    heads, rng = Heads(3), np.random.default_rng(6)
    first = heads.run(10)[-1]
    heads.mounts = [q * rng.choice([-1, 1]) for q in heads.mounts]
    for _ in range(10):
        heads.mounts = [-q for q in heads.mounts]
        results = heads.run(1)
        assert all(result.quaternion @ first.quaternion > 0 for result in results)
    assert all(heads.state(head) is HeadState.USED for head in range(3))


def test_time_that_goes_back_for_all_is_a_new_start():
    heads = Heads(2)
    heads.time_s = 1000.0
    heads.run(10)
    heads.time_s = 0.0
    results = heads.run(10)
    assert results[-1] is not None and heads.error_arcsec(results[-1]) < 0.1


@pytest.mark.parametrize(('quaternion', 'covariance'), [
    ([0, 0, 0, np.nan], COVARIANCE), ([0, 0, 0, 0.9], COVARIANCE),
    ([0, 0, 0, 1], COVARIANCE * np.nan), ([0, 0, 0, 1], -COVARIANCE),
    ([0, 0, 0, 1], np.diag([1.0, 1.0, 0.0])), ([0, 0, 0, 1], np.diag([1.0, -1.0, -1.0]))])
def test_what_is_not_an_attitude_is_rejected(quaternion, covariance):
    with pytest.raises(ValueError, match='not an attitude|not positive definite'):
        HeadFrame(START_NS, np.array(quaternion, float), covariance)


def test_nees_with_gyro_and_heads_that_drop_out_and_no_jump():
    run = SceneRun(Scene(30.0, drop_s=4.0, delays_s=(0.0, 0.12, 0.03)), np.random.default_rng(4))
    fusion = AttitudeFusion(run.mount_file(), FusionOptions(), KNOWN)
    outcomes = list(run.events(fusion))
    errors, covariances = errors_of(outcomes)
    assert len(errors) > 150 and fusion.uses_gyro
    nees = nees_of(errors, covariances)
    # The process noise is for motions that begin, and this one goes on.
    check_mean(3, nees, inflation=1.25)
    # Nothing jumps: no error beyond what chance has in so many frames.
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert np.max(np.abs(errors) / sigma) < 4.5


@pytest.mark.slow
def test_a_noisy_gyro_makes_no_attitude_worse():
    squares = {}
    for gyro in (False, True):
        scene, runs = Scene(40.0, gyro=gyro, turn_deg_s=0.1, wobble_deg_s=0.05), []
        for seed in range(4):
            run = SceneRun(scene, np.random.default_rng(seed))
            fusion = AttitudeFusion(run.mount_file(), FusionOptions(), KNOWN)
            runs.append(errors_of(list(run.events(fusion))[60:])[0] ** 2)
            assert fusion.uses_gyro == gyro
        squares[gyro] = np.concatenate(runs).mean()
    # By its rates alone it was twice as far off, hence four times.
    assert squares[True] < 1.5 * squares[False]


@pytest.mark.parametrize('scene', [
    Scene(40.0, gyro=False, wobble_deg_s=0.5), Scene(40.0, gyro=False, wobble_deg_s=2.0, heads=2),
    Scene(40.0, gyro=False, wobble_deg_s=0.0, acceleration_deg_s2=0.02, heads=2)])
def test_without_a_gyro_the_covariance_is_that_of_a_body_that_changes_its_rate(scene):
    """By the process noise of the options a tenth of the frames were wrong."""
    for seed in range(3):
        run = SceneRun(scene, np.random.default_rng(seed))
        outcomes = list(run.events(AttitudeFusion(run.mount_file(), FusionOptions(), KNOWN)))
        errors, covariances = errors_of(outcomes)
        assert len(errors) > 0.95 * 40.0 / 0.2 * scene.heads
        assert not count_wrong(errors, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))).wrong
        assert 1.8 < nees_of(errors, covariances).mean() < 3.8


@pytest.mark.parametrize('wrong', WRONG_GYROS)
def test_a_gyro_that_is_a_little_wrong_is_named_and_does_no_harm(wrong):
    run = SceneRun(Scene(60.0, turn_deg_s=0.3, wobble_deg_s=0.5, wrong_gyro=wrong),
                   np.random.default_rng(1))
    fusion = AttitudeFusion(run.mount_file(), FusionOptions(), KNOWN)
    errors, covariances = errors_of(list(run.events(fusion)))
    assert not count_wrong(errors, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))).wrong
    assert len(errors) > 850 and nees_of(errors, covariances).mean() < 3.8
    assert not fusion.uses_gyro and 'imu reports' in fusion.gyro_trouble


@pytest.mark.parametrize('error_arcsec', [2.0, 8.0, 15.0, 25.0, 60.0])
def test_a_head_that_returns_moves_the_attitude_by_3_sigma_at_most(error_arcsec):
    heads = Heads(2, mount_options=KNOWN)
    heads.run(30)
    heads.run(30, heads=[0])
    error = np.array([0.0, 0.0, error_arcsec * ARCSEC])
    moved = []
    for _ in range(20):
        alone, = heads.run(1, heads=[0])
        result = heads.frame(1, heads.time_s + 0.01, error)
        if result is not None:
            sigma = np.sqrt(np.diag(alone.covariance))
            change = attitude_error(result.quaternion, turned(alone.quaternion, RATE * 0.01))
            moved.append(np.max(np.abs(change) / sigma))
    # What does not agree has not returned.
    assert (heads.state(1) is HeadState.USED) == bool(moved)
    assert (error_arcsec < 10) <= bool(moved) and (error_arcsec > 50) <= (not moved)
    assert max(moved, default=0.0) <= 3.05


@pytest.mark.parametrize('fault', ['mount wrong by 1 deg', 'time offset 0.2 s', 'jump of 1 deg'])
def test_a_faulty_head_is_excluded_and_nothing_wrong_comes_out(fault):
    run = SceneRun(Scene(20.0, fault=fault, fault_s=10.0 if 'jump' in fault else 0.0),
                   np.random.default_rng(5))
    fusion = AttitudeFusion(run.mount_file(), FusionOptions(), MountOptions(
        mount_sigma_arcsec=3.0))
    errors, _ = errors_of(list(run.events(fusion)))
    assert run.excluded_after <= 10
    assert len(errors) > 150 and np.abs(errors).max() < 30 * ARCSEC


def test_a_head_with_larger_errors_than_it_says_counts_less():
    """And the others, and the attitude, are as without it."""
    run = SceneRun(Scene(130.0, fault=UNDERSTATED), np.random.default_rng(2))
    fusion = AttitudeFusion(run.mount_file(), mount_options=MountOptions(
        mount_sigma_arcsec=0.0, mount_walk_arcsec_sqrt_h=0.0))
    errors, covariances = errors_of(list(run.events(fusion)))
    # 10 where its covariance is used as it is. What is published allows for motions that begin.
    check_mean(3, nees_of(errors, covariances)[600:], inflation=1.25)
    scales = [head.noise_scale for head in fusion.heads.values()]
    understated = scales.pop(run.faulty)
    assert UNDERSTATED_BY ** 2 / 1.5 < understated < UNDERSTATED_BY ** 2 * 1.5
    assert scales == [1.0, 1.0]
    assert fusion.heads[NAMES[run.faulty]].stands_out


def test_two_heads_with_larger_errors_than_they_say_are_both_named():
    run = SceneRun(Scene(130.0, fault=UNDERSTATED, faulty_heads=2), np.random.default_rng(2))
    fusion = AttitudeFusion(run.mount_file(), mount_options=KNOWN)
    # The covariance allows for motions that may begin.
    check_mean(3, nees_of(*errors_of(list(run.events(fusion))))[600:], inflation=2.0)
    named = [head for head, name in enumerate(NAMES) if fusion.heads[name].stands_out]
    assert named == sorted(run.all_faulty)


@pytest.mark.parametrize('seed', [10, 13, 25, 59, 68, 95])
def test_two_heads_begin_only_where_they_agree_well(seed):
    """A clock that is late by 4 sigma of two heads agreed within the gate, and stayed."""
    run = SceneRun(Scene(12.0, fault='time offset 0.2 s'), np.random.default_rng(seed))
    fusion = AttitudeFusion(run.mount_file(), mount_options=MountOptions(mount_sigma_arcsec=3.0))
    errors, covariances = errors_of(list(run.events(fusion)))
    assert run.excluded_after <= 10
    assert count_wrong(errors, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))).wrong == 0
    assert [fusion.heads[name].state for head, name in enumerate(NAMES)
            if head != run.faulty] == 2 * [HeadState.USED]


def bent_until_implausible(heads, errors_arcsec):
    """Run heads whose mounts are off by less than a frame shows, and return their states."""
    heads.covariance = np.eye(3) * (3 * ARCSEC) ** 2
    heads.run(5, heads=[head for head, error_arcsec in errors_arcsec.items() if error_arcsec < 60])
    for _ in range(200):
        heads.time_s += 0.2
        for head, error_arcsec in errors_arcsec.items():
            heads.frame(head, heads.time_s + 0.01 * head, [error_arcsec * ARCSEC, 0.0, 0.0])
            if 'mounts_file' in heads.fusion.trouble:
                return [heads.state(head) is HeadState.EXCLUDED for head in errors_arcsec]
    return None


@pytest.mark.parametrize(('errors_arcsec', 'wrong', 'excluded'), [
    ({0: 0.0, 1: 0.0, 2: 8.5}, 'head_3', [False, False, True]),
    # So that both are found by one check.
    ({0: 0.0, 1: 8.82, 2: 8.5}, 'head_2, head_3', [True, False, False]),
    ({0: 0.0, 1: 8.5}, 'head_2', [True, True])])
def test_a_mount_that_leaves_its_file_is_named_and_two_are_the_reference(
        errors_arcsec, wrong, excluded):
    heads = Heads(len(errors_arcsec), mount_options=MountOptions(
        mount_sigma_arcsec=1.0, mount_walk_arcsec_sqrt_h=0.0))
    assert bent_until_implausible(heads, errors_arcsec) == excluded
    text = f'mount of {wrong} further from mounts_file than its sigma allows'
    assert heads.fusion.trouble == text
    assert {head.reason for head in heads.fusion.heads.values()} == (
        {text} if all(excluded) else {text, ''})


def test_the_reference_is_not_wrong_where_it_does_not_count():
    """Two mounts that leave their file are then against each other, not against its own."""
    heads = Heads(3, mount_options=MountOptions(
        mount_sigma_arcsec=1.0, mount_walk_arcsec_sqrt_h=0.0))
    heads.run(10)
    heads.run(4, errors={0: [0.02, 0.0, 0.0]})
    assert heads.state(0) is HeadState.EXCLUDED
    assert bent_until_implausible(heads, {0: np.degrees(0.02) * 3600, 1: 0.0, 2: 8.5}) == [
        True, True, True]


def test_a_covariance_that_is_invalid_is_given_up():
    heads = Heads(2)
    heads.run(5)
    for variances in ([1e-39, 1e-19, 1e30], [1e-16, 1e37, 1e-19]):
        heads.covariance = np.diag(variances)
        result, = heads.run(1, heads=[0])
        assert result is None and heads.fusion.trouble.startswith(
            'the covariance of the filter is not positive definite, its diagonal is [')
        # And restarts, without what was estimated with it.
        heads.covariance = COVARIANCE
        last = heads.run(3)[-1]
        assert heads.error_arcsec(last) < 0.1 and heads.fusion.trouble == ''
        assert np.linalg.eigvalsh(last.covariance)[0] > 0


def test_more_heads_than_there_is_room_for_are_refused():
    mounts = {f'head_{number}': Mount(np.array([0.0, 0.0, 0.0, 1.0])) for number in range(14)}
    with pytest.raises(ValueError, match='heads = 14 is not within 1 .. 13'):
        AttitudeFusion(mounts)
    with pytest.raises(ValueError, match='coefficients of mounts = 48 is not within 0 .. 36'):
        AttitudeFusion(dict(list(mounts.items())[:5]), mount_options=MountOptions(
            mount_temperature_arcsec_k=1.0, mount_orbit_arcsec=1.0))
    with pytest.raises(ValueError, match='no heads'):
        AttitudeFusion({})


def test_heads_of_50_hz_may_be_late_by_the_horizon():
    heads = Heads(2)
    for frame in range(200):
        for head in range(2):
            heads.frame(head, 0.02 * frame + 0.001 * head)
    assert heads.frame(0, 0.02 * 199 - 0.95) is None
    assert heads.fusion.heads['head_1'].counts['late'] == 0


def test_a_gyro_at_its_range_is_named_and_not_used():
    heads = Heads(2, gyro_options=GyroErrorOptions(gyro_range_deg_s=5.0))
    fusion = heads.fusion

    def run(frames, rate):
        for _ in range(frames):
            begin_s = heads.time_s
            for tick in range(4):
                heads.fusion.add_rate(
                    START_NS + round((begin_s + 0.05 * (tick + 1)) * 1e9), rate)
            result = heads.run(1)[-1]
        return result
    run(12, RATE)
    assert fusion.uses_gyro and fusion.gyro_trouble == ''
    result = run(3, np.radians([0.0, 6.0, 0.0]))
    assert not fusion.uses_gyro and 'gyro_range_deg_s' in fusion.gyro_trouble
    assert result is not None and heads.error_arcsec(result) < 0.1
    # The rate of the heads alone is far less certain than that of the gyro.
    assert result.rate_covariance[0, 0] > 0
    run(4, RATE)
    assert not fusion.uses_gyro and 'gyro_range_deg_s' in fusion.gyro_trouble
    run(10, RATE)
    assert fusion.uses_gyro and fusion.gyro_trouble == ''


def test_filtered_attitudes_count_less():
    covariances = []
    for correlation_s in (0.0, 0.4):
        heads = Heads(2, FusionOptions(correlation_s=correlation_s))
        heads.run(9)
        covariances.append(heads.run(1)[-1].covariance)
    assert np.trace(covariances[1]) > 2 * np.trace(covariances[0])
