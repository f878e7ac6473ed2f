# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The acceleration out of the attitudes of frames, and what it does to an exposure."""

import numpy as np
import pytest
from scipy.stats import norm
from startracker_evaluation.campaign.integrity_motion import motion_runs
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.maths.rotation import ARCSEC, multiply, quaternion_from_rotation_vector
from startracker_ros.core.track.acceleration import (
    AngularAcceleration, lacking, MISSED, STEADY)
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

DT_S, SIGMA = 0.1, 0.4 * ARCSEC
AXIS = np.array([0.6, 0.8, 0.0])
EXPOSED = (DT_S, DT_S)


def frames(angle_of, count=200, seed=1, exposure_s=DT_S):
    """Yield an estimate after each frame, and the angle of its light from the middle, in rad."""
    rng, found = np.random.default_rng(seed), AngularAcceleration()
    part_s = exposure_s * ((np.arange(41) + 0.5) / 41 - 0.5)
    for frame in range(count):
        time_s = frame * DT_S
        light = np.mean(angle_of(time_s + part_s))
        noise = quaternion_from_rotation_vector(SIGMA * rng.standard_normal(3))
        found.add(round(time_s * 1e9), multiply(
            quaternion_from_rotation_vector(light * AXIS), noise), np.eye(3) * SIGMA ** 2)
        yield found, light - angle_of(time_s)


def sway(amplitude_deg, period_s):
    return lambda time_s: np.radians(amplitude_deg) * np.sin(2 * np.pi * time_s / period_s + 0.7)


@pytest.mark.parametrize(('amplitude_deg', 'period_s'), [
    (1.0, 10.0), (0.2, 2.0), (0.05, 1.0), (0.01, 0.5), (5.0, 20.0)])
def test_the_shift_of_a_sway_is_taken_out_within_its_covariance(amplitude_deg, period_s):
    left, seen, normalised = [], [], []
    for found, shift in frames(sway(amplitude_deg, period_s)):
        turn, covariance, _ = found.shift(EXPOSED, np.zeros(3), 4900.0)
        left.append(shift - turn @ AXIS)
        seen.append(shift)
        normalised.append(left[-1] ** 2 / (AXIS @ covariance @ AXIS + SIGMA ** 2))
    settled = slice(20, None)
    assert np.std(left[settled]) < 0.35 * np.std(seen[settled])
    # The first two frames show no acceleration, and a single attitude is known by SIGMA.
    assert np.max(normalised[2:]) < 25 and np.mean(normalised[settled]) < 1.3


@pytest.mark.parametrize('hertz', [2.7, 7.3, 12.7])
def test_a_vibration_faster_than_the_frames_is_not_mistaken_for_a_sway(hertz):
    """At 10 frames a second all three look alike; of the faster ones the mean pointing counts."""
    normalised = []
    for found, shift in frames(sway(40 / 3600, 1 / hertz), exposure_s=0.09):
        turn, covariance, _ = found.shift((0.09, 0.09), np.zeros(3), 4900.0)
        error = turn @ AXIS - (shift if hertz < 5 else 0.0)
        normalised.append(error ** 2 / (AXIS @ covariance @ AXIS + SIGMA ** 2))
    assert np.max(normalised[20:]) < 25 and np.mean(normalised[20:]) < 1.3


@pytest.mark.parametrize(('amplitude_deg', 'period_s'), [
    (0.2, 2.0), (0.05, 1.0), (0.03, 0.5), (0.01, 0.35)])
def test_the_next_angle_and_rate_of_a_sway_are_predicted(amplitude_deg, period_s):
    angle, errors = sway(amplitude_deg, period_s), []

    def rate_at(time_s):
        return (angle(time_s + 1e-4) - angle(time_s - 1e-4)) / 2e-4
    for frame, (found, _) in enumerate(frames(angle, exposure_s=0.0)):
        # The constant acceleration that leads from this angle and rate to the next angle.
        now_s, next_s = frame * DT_S, (frame + 1) * DT_S
        needed = 2 * (angle(next_s) - angle(now_s) - rate_at(now_s) * DT_S) / DT_S ** 2
        change = (rate_at(next_s) - rate_at(now_s)) / DT_S
        found = found.estimate
        errors.append((needed - found.value @ AXIS, change - found.value @ AXIS,
                       needed - found.ahead @ AXIS, change - found.mean @ AXIS))
    held, held_change, ahead, mean = np.std(errors[40:], axis=0)
    # Of a slow sway ahead = 4 / 3 (2 a - a') - a / 3 of the last differences a and a' before, and
    # mean likewise: at most 9 times the noise of an attitude.
    noise = 9 * SIGMA / DT_S ** 2
    assert ahead < 0.1 * held + noise
    assert mean < 0.1 * held_change + noise


# Of an oscillation that may be a vibration half of the shift is taken out.
@pytest.mark.parametrize(('amplitude_deg', 'period_s', 'part'), [
    (0.2, 2.0, 1.0), (0.05, 1.0, 1.0), (0.01, 0.35, 0.5)])
def test_the_error_of_the_newest_attitude_is_in_the_shift_by_its_share(
        amplitude_deg, period_s, part):
    angle, turns = sway(amplitude_deg, period_s), []
    for error in (0.0, 1e-3 * SIGMA):
        found = list(frames(angle, count=80))[-1][0]
        before = found.estimate
        found.add(80 * 10 ** 8, multiply(quaternion_from_rotation_vector(angle(8.0) * AXIS),
                                         quaternion_from_rotation_vector(error * AXIS)),
                  np.eye(3) * SIGMA ** 2)
        shift = found.shift(EXPOSED, np.zeros(3), 4900.0)
        turns.append(shift.turn @ AXIS)
    assert before.way == found.estimate.way != STEADY
    # What the error changes of the fitted frequency is small.
    assert (turns[1] - turns[0]) / (1e-3 * SIGMA) == pytest.approx(shift.share, abs=0.02)
    assert abs(shift.share) > 0.02 * part


def test_a_steady_turn_costs_next_to_nothing():
    for found, _ in frames(lambda time_s: np.radians(0.3) * time_s, exposure_s=0.0):
        turn, covariance, _ = found.shift(EXPOSED, np.radians(0.3) * AXIS, 4900.0)
    assert not turn.any() and not found.estimate.process.any()
    assert (np.sqrt(np.diag(covariance)) < 0.1 * SIGMA).all()


def test_an_unknown_exposure_is_between_none_and_the_interval():
    found, shift = list(frames(sway(0.2, 2.0), count=60))[-1]
    turn, covariance, _ = found.shift((0.0, np.inf), np.zeros(3), 4900.0)
    known, *_ = found.shift(EXPOSED, np.zeros(3), 4900.0)
    assert turn @ AXIS == pytest.approx(known @ AXIS / 2, rel=0.1)
    assert np.sqrt(AXIS @ covariance @ AXIS) >= 0.9 * abs(turn @ AXIS)
    none, *_ = found.shift((0.0, 0.0), np.zeros(3), 4900.0)
    assert not none.any()
    assert abs(known @ AXIS - shift) < 0.2 * abs(shift) + 0.5 * SIGMA


def test_a_jump_of_the_rate_is_in_the_covariance_of_its_frame_only():
    rng, found = np.random.default_rng(3), AngularAcceleration()
    sigmas = []
    for frame in range(40):
        angle = 100 * ARCSEC * max(frame - 29.5, 0)
        probability = {30: 1.0, 38: 0.01}.get(frame, 0.0)
        found.add(frame * 10 ** 8, multiply(quaternion_from_rotation_vector(angle * AXIS),
                  quaternion_from_rotation_vector(SIGMA * rng.standard_normal(3))),
                  np.eye(3) * SIGMA ** 2, 50 * ARCSEC * AXIS, probability)
        covariance = found.shift(EXPOSED, np.zeros(3), 4900.0).covariance
        sigmas.append(np.sqrt(AXIS @ covariance @ AXIS) / ARCSEC)
    assert sigmas[29] < 0.1 and 50 < sigmas[30] < 51 and sigmas[35] < 0.3
    # What may be a jump is in the covariance by its probability.
    assert sigmas[37] < 0.3 and 5 < sigmas[38] < 5.1


def test_the_probability_of_a_jump_within_an_exposure_is_that_of_its_frame():
    found, still = AngularAcceleration(), np.array([0.0, 0.0, 0.0, 1.0])
    assert found.jump_within(EXPOSED[1]) == 0
    for frame in range(20):
        found.add(frame * 10 ** 8, still, np.eye(3) * SIGMA ** 2, np.zeros(3), 0.02)
    assert found.jump_within(EXPOSED[1]) == found.jump_within(np.inf) == 0.02
    assert found.jump_within(DT_S / 4) == pytest.approx(0.005)
    found.interrupt()
    assert found.jump_within(EXPOSED[1]) == 0


def test_only_fits_of_streaks_see_their_ends():
    found, _ = list(frames(sway(1.0, 10.0), count=60))[-1]
    rate = np.radians(2.0) * AXIS
    centre, streak = (found.shift(EXPOSED, rate, focal_px) for focal_px in (0.0, 4900.0))
    assert streak.turn @ AXIS > 1.3 * (centre.turn @ AXIS)
    assert AXIS @ streak.covariance @ AXIS > 3 * (AXIS @ centre.covariance @ AXIS)


@pytest.mark.parametrize('probability', [2.5e-3, 1e-2, 0.1, 0.4])
def test_an_improbable_error_is_beyond_5_sigma_as_rarely_as_is_left_to_chance(probability):
    covariance = np.diag([1.0, 1.0, 300.0]) + 0.3
    axis = np.array([0.6, -0.7, 4.0])
    axis /= np.sqrt(axis @ np.linalg.solve(covariance, axis))
    for distance in (0.5, 3.0, 6.0, 40.0):
        error = distance * axis
        more = lacking(covariance, error, probability)
        assert np.linalg.eigvalsh(more)[0] > -1e-9
        away = np.sqrt(error @ np.linalg.solve(covariance + more, error))
        # What is known of the error besides is normal, of one sigma.
        assert probability * norm.sf(WRONG_SIGMAS - away) < MISSED
        assert away < 0.999 * distance if more.any() else away == pytest.approx(distance)


def test_an_error_that_is_left_to_chance_needs_no_covariance():
    assert not lacking(np.eye(3), np.full(3, 100.0), 2 * MISSED).any()
    assert lacking(np.eye(3), np.full(3, 100.0), 2.1 * MISSED).any()


def test_what_moved_before_a_gap_is_not_forgotten():
    found, _ = list(frames(sway(0.2, 2.0), count=60))[-1]
    found.interrupt()
    covariance = found.shift(EXPOSED, np.zeros(3), 4900.0).covariance
    assert not found.estimate.value.any() and np.sqrt(AXIS @ covariance @ AXIS) > 1.0 * ARCSEC


@pytest.mark.parametrize('name', [
    'list, sway 0.05 deg, 1 s', 'list, sway 1 deg, 10 s, exposed 0.1 s',
    'list, steps of 0.5 deg/s each second', 'list, stamps that err by 5 ms'])
def test_the_covariance_of_a_tracker_holds_whatever_moves(name):
    tally = motion_runs(name, 1, 5, frames=100)
    assert tally.available == tally.due == 98
    # One frame in five is independent.
    high = mean_chi_square_bounds(3, tally.published // 5)[1]
    assert not tally.wrong and tally.nees / tally.published < high


@pytest.mark.parametrize(('name', 'seed'), [
    ('list, ramps of 0.5 deg/s^2, 4 s, exposed 0.1 s', 712814),
    ('list, steps of 0.05 deg/s each 3 s, exposed 0.1 s', 704894)])
def test_what_jumps_within_an_exposure_unseen_is_no_wrong_attitude(name, seed):
    tally = motion_runs(name, 1, seed)
    assert tally.available == tally.due and not tally.wrong
