# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Jumps of the rate that the gain of a filter hides: a filter of its own is the slow oracle."""

import numpy as np
import pytest
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.track.rate_jumps import HiddenJumps, RateJumps

DT_NS = 100_000_000
DT_S = DT_NS * 1e-9
RATE = np.radians([0.02, -0.01, 0.03])
R = np.diag([0.07, 0.07, 0.7]) ** 2 * ARCSEC ** 2
DENSITY = np.full(3, (18 * ARCSEC) ** 2 * DT_S)  # 0.005 deg/s^2
RATIO, SHARE = 0.02, 0.01
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def start():
    covariance = np.zeros((9, 9))
    covariance[:3, :3], covariance[3:6, 3:6] = R, 2 * R / DT_S ** 2
    covariance[:3, 3:6] = covariance[3:6, :3] = R / DT_S
    covariance[6:, 6:] = np.eye(3) * 1e-12
    return AttitudeState(0, IDENTITY, RATE, np.zeros(3), covariance)


def updated(prediction, turn):
    return prediction.state.with_attitude(np.linalg.inv(R), np.linalg.solve(R, turn))


def frames(count, seed, moved=None):
    """Yield the filter's prediction and the turn that the stars measure; the last is moved."""
    rng = np.random.default_rng(seed)
    state, truth = start(), IDENTITY
    for frame in range(1, count + 1):
        truth = turned(truth, RATE * DT_S)
        measured = turned(truth, rng.multivariate_normal(np.zeros(3), R))
        if moved is not None and frame == count:
            measured = turned(measured, moved)
        prediction = state.predicted_at_constant_rate(frame * DT_NS, DENSITY, 0.0)
        turn = rotation_between(prediction.state.quaternion, measured)
        state = updated(prediction, turn)
        yield prediction, turn, measured


def test_it_is_the_filter_of_the_process_noise_that_there_is():
    hidden, steady = HiddenJumps(), None
    for frame, (prediction, turn, measured) in enumerate(frames(30, 1), 1):
        hidden.add(prediction, turn, R, np.full(3, RATIO), SHARE)
        predicted = prediction if steady is None else steady.predicted_at_constant_rate(
            frame * DT_NS, RATIO * DENSITY, 0.0)
        if hidden.probability == 0:
            steady = updated(predicted, rotation_between(predicted.state.quaternion, measured))
            continue
        expected = rotation_between(prediction.state.quaternion, predicted.state.quaternion)
        np.testing.assert_allclose(hidden.expected, expected, atol=1e-4 * ARCSEC)
        v = rotation_between(predicted.state.quaternion, measured)
        S = predicted.state.covariance[:3, :3] + R
        chi2 = v @ np.linalg.solve(S, v)
        odds = SHARE * (3 / 7) ** 1.5 * np.exp(chi2 * 2 / 7)
        assert hidden.probability == pytest.approx(odds / (1 + odds), rel=1e-3)
        steady = updated(predicted, v)
    assert frame == 30


def test_a_jump_that_moves_the_stars_of_one_frame_is_seen_beside_the_steady_turn():
    moved = np.array([0.6, 0.0, 0.0]) * ARCSEC
    found, by_filter, chance = [], [], []
    for seed in range(20):
        hidden, jumps = HiddenJumps(), RateJumps()
        for frame, (prediction, turn, _) in enumerate(frames(40, seed, moved)):
            chance.append(hidden.probability)
            hidden.add(prediction, turn, R, np.full(3, RATIO), SHARE)
            mixture = jumps.add(frame * DT_NS, prediction.state, turn, R)
        found.append(hidden.probability)
        by_filter.append(mixture.newest)
    assert np.median(found) > 0.95 and np.median(by_filter) < 0.1
    assert np.mean(chance) < 0.02


def test_after_a_jump_it_begins_anew():
    hidden = HiddenJumps()
    for prediction, turn, _ in frames(40, 1, np.array([3.0, 0.0, 0.0]) * ARCSEC):
        hidden.add(prediction, turn, R, np.full(3, RATIO), SHARE)
    assert hidden.probability > 0.99
    hidden.add(prediction, turn, R, np.full(3, RATIO), SHARE)
    assert hidden.probability == 0 and not hidden.expected.any()
