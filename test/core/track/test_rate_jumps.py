# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Jumps of the rate: as many filters, one for each jump, are the slow oracle."""

import numpy as np
from scipy.stats import multivariate_normal
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.track.rate_jumps import FRAMES, RateJumps, SIZE

DT_NS = 100_000_000
DT_S = DT_NS * 1e-9
RATE = np.radians([0.3, -0.2, 1.0])
R = np.diag([1.0, 1.0, 400.0]) * ARCSEC ** 2
QUIET = np.full(3, (0.5 * ARCSEC) ** 2)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def start():
    covariance = np.zeros((9, 9))
    covariance[:3, :3], covariance[3:6, 3:6] = R, 2 * R / DT_S ** 2
    covariance[:3, 3:6] = covariance[3:6, :3] = R / DT_S
    return AttitudeState(0, IDENTITY, RATE, np.zeros(3), covariance)


def frames(jump, at, count, seed):
    """Yield a quiet filter's prediction, the turn that the stars measure, and the correction."""
    rng = np.random.default_rng(seed)
    state, truth, rate = start(), IDENTITY, RATE.copy()
    for frame in range(1, count + 1):
        if frame == at:
            rate = rate + jump
        truth = turned(truth, rate * DT_S)
        measured = turned(truth, rng.multivariate_normal(np.zeros(3), R))
        predicted = state.propagated_at_constant_rate(frame * DT_NS, QUIET, 0.0)
        turn = rotation_between(predicted.quaternion, measured)
        state = predicted.with_attitude(np.linalg.inv(R), np.linalg.solve(R, turn))
        yield predicted, turn, state, truth


class Oracle:
    """A filter for each frame before which the rate may have jumped, and one without a jump."""

    def __init__(self):
        self.filters = [(start(), 0.0, False)]

    def add(self, predicted, turn, share):
        stars = turned(predicted.quaternion, turn)
        S = predicted.covariance[:3, :3] + R
        F = np.zeros((9, 3))
        F[:3], F[3:6] = np.eye(3) * DT_S / np.sqrt(3), np.eye(3) * np.sqrt(0.75)
        new = F @ (S * SIZE / DT_S ** 2) @ F.T
        after = []
        for state, log, jumped in self.filters + [(*self.filters[0][:2], True)]:
            born = jumped and len(after) == len(self.filters)
            state = state.propagated_at_constant_rate(predicted.stamp_ns, QUIET, 0.0)
            if born:
                state = state._replace(covariance=state.covariance + new)
            z = rotation_between(state.quaternion, stars)
            log += multivariate_normal.logpdf(
                z / ARCSEC, np.zeros(3), (state.covariance[:3, :3] + R) / ARCSEC ** 2)
            after.append((state.with_attitude(np.linalg.inv(R), np.linalg.solve(R, z)), log,
                          jumped))
        self.filters = [after[0], *after[1:][-FRAMES:]]
        quiet = self.filters[0][0]
        ratios = np.array([np.exp(log - after[0][1]) * (share if jumped else 1.0)
                           for _, log, jumped in self.filters])
        weights = ratios / ratios.sum()
        mean, second = np.zeros(6), np.zeros((6, 6))
        for (state, _, _), weight in zip(self.filters, weights):
            error = np.concatenate([rotation_between(quiet.quaternion, state.quaternion),
                                    state.rate - quiet.rate])
            mean += weight * error
            second += weight * (np.outer(error, error)
                                + state.covariance[:6, :6] - quiet.covariance[:6, :6])
        return 1 - weights[0], weights[-1], mean, second - np.outer(mean, mean)


def test_the_mixture_is_that_of_a_filter_for_each_jump():
    jumps, oracle = RateJumps(), Oracle()
    unit = np.repeat([ARCSEC, ARCSEC / DT_S], 3)
    for frame, (predicted, turn, _, _) in enumerate(
            frames(np.array([0.5, 0.0, 9.0]) * ARCSEC / DT_S, 15, 26, 2)):
        probability, newest, mean, covariance = oracle.add(predicted, turn, jumps.share)
        found = jumps.add(frame * DT_NS, predicted, turn, R)
        # The filters turn by rates that differ: a second order of the turn between two frames.
        np.testing.assert_allclose([found.probability, found.newest], [probability, newest],
                                   rtol=5e-3)
        np.testing.assert_allclose(found.mean / unit, mean / unit, rtol=1e-2, atol=1e-3)
        np.testing.assert_allclose(found.covariance / np.outer(unit, unit),
                                   covariance / np.outer(unit, unit), rtol=1e-2, atol=1e-2)
        if found.is_certain:
            break
    assert 15 < frame < 25


def test_a_jump_becomes_certain_and_gives_the_new_rate():
    jump = np.array([2.0, -1.0, 0.0]) * ARCSEC / DT_S
    jumps = RateJumps()
    certain = []
    for frame, (predicted, turn, state, _) in enumerate(frames(jump, 60, 80, 5), 1):
        found = jumps.add((frame - 1) * DT_NS, predicted, turn, R)
        if found.is_certain and not certain:
            error = RATE + jump - (state.rate + found.mean[3:])
            covariance = state.covariance[3:6, 3:6] + found.covariance[3:, 3:]
            certain.append(frame)
            assert error @ np.linalg.solve(covariance, error) < 16.3  # 0.1 % of chi-square, 3
            assert np.linalg.norm(error) < np.linalg.norm(RATE + jump - state.rate)
    assert 60 <= certain[0] < 60 + FRAMES


def test_quiet_motion_has_no_jump_and_learns_that_there_are_few():
    jumps, first = RateJumps(), RateJumps().share
    for frame, (predicted, turn, _, _) in enumerate(frames(np.zeros(3), 0, 400, 7)):
        assert not jumps.add(frame * DT_NS, predicted, turn, R).is_certain
    assert jumps.share < 0.4 * first


def test_a_frame_that_contradicts_its_prediction_makes_jumps_more_probable():
    jumps = RateJumps()
    predicted, turn, _, _ = next(frames(np.zeros(3), 0, 1, 1))
    before, share = jumps.add(0, predicted, turn, R), jumps.share
    for _ in range(5):
        assert jumps.found().newest == 1.0
    assert jumps.share > 5 * share
    assert jumps.add(0, predicted, turn, R).newest > 5 * before.newest
