# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The ratio of process noise, of bodies that move more and less than a filter assumes."""

import numpy as np
import pytest
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.core.maths.compiled_rotation import rotation_between, turned
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.track.process_noise import ProcessNoise

DT_NS = 100_000_000
DT_S = DT_NS * 1e-9
RATE = np.radians([0.3, -0.2, 1.0])
R = np.diag([1.0, 4.0, 100.0]) * ARCSEC ** 2
DENSITY = np.array([20.0, 20.0, 200.0]) * ARCSEC ** 2
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def start(rng):
    covariance = np.zeros((9, 9))
    covariance[:3, :3], covariance[3:6, 3:6] = R, 2 * R / DT_S ** 2
    covariance[:3, 3:6] = covariance[3:6, :3] = R / DT_S
    covariance[6:, 6:] = np.eye(3) * 1e-6
    error = rng.multivariate_normal(np.zeros(6), covariance[:6, :6])
    return AttitudeState(0, turned(IDENTITY, error[:3]), RATE + error[3:], np.zeros(3), covariance)


def frames(ratio, count, seed, gyro_noise=None):
    """Yield the noise learnt, the state and the true attitude and rate after each frame."""
    rng = np.random.default_rng(seed)
    state, truth, rate, noise = start(rng), IDENTITY, RATE, ProcessNoise()
    gyro = Gyro(GyroErrorOptions(gyro_noise_deg_sqrt_h=gyro_noise or 0.0))
    # The integral of white acceleration, of a frame of four parts.
    parts, part_s = 4, DT_S / 4
    for frame in range(1, count + 1):
        for part in range(1, parts + 1):
            before = rate
            rate = rate + np.sqrt(ratio * DENSITY * part_s) * rng.standard_normal(3)
            truth = turned(truth, (rate + before) / 2 * part_s)
            gyro.add(((frame - 1) * parts + part) * DT_NS // parts,
                     (rate + before) / 2 + rng.normal(
                         0, np.sqrt(gyro.noise_density / part_s), 3))
        to_ns = frame * DT_NS
        prediction = (state.predicted_at_constant_rate(to_ns, DENSITY, 0.0) if gyro_noise is None
                      else gyro.filtered(state, to_ns, np.zeros(3), DENSITY))
        measured = turned(truth, rng.multivariate_normal(np.zeros(3), R))
        predicted = prediction.state
        turn = rotation_between(predicted.quaternion, measured)
        state = predicted.with_attitude(np.linalg.inv(R), np.linalg.solve(R, turn))
        noise.add(prediction, predicted.covariance, state.covariance, turn, R)
        yield noise, state, truth, rate


def nees(noise, state, truth, rate):
    """Return that of the attitude, of the covariance with the noise learnt, and without."""
    error = rotation_between(state.quaternion, truth)
    return [error @ np.linalg.solve(P[:3, :3], error) for P in (
        state.covariance[:6, :6] + noise.excess, state.covariance)]


@pytest.mark.parametrize('ratio, gyro_noise', [
    (0.0, None), (5.0, None), (1.0, 0.1), *(
        pytest.param(*case, marks=pytest.mark.long)
        for case in ((1.0, None), (0.0, 0.1), (5.0, 0.1)))])
def test_the_ratio_is_unbiased_and_the_covariance_true(ratio, gyro_noise):
    found, learnt, assumed = [], [], []
    for seed in range(30):
        run = [(noise._memory.score.copy(), noise._memory.information.copy(), nees(noise, *rest))
               for noise, *rest in frames(np.full(3, ratio), 150, seed, gyro_noise)]
        score, information, _ = run[-1]
        found.append(1 + score / information)
        learnt.append(np.array([both[0] for *_, both in run[30:]]))
        assumed.append(np.mean([both[1] for *_, both in run[30:]]))
    error = np.std(found, axis=0) / np.sqrt(len(found))
    assert (np.abs(np.mean(found, axis=0) - ratio) < 4 * error + 0.02).all()
    # The mean of a normalised square is larger where its covariance is an estimate.
    assert abs(np.mean(learnt) - 3) < 0.25 * abs(np.mean(assumed) - 3) + 0.2


def test_each_axis_has_its_own():
    ratio = np.array([0.0, 6.0, 0.0])
    found = np.mean([[noise.ratio for noise, *_ in frames(ratio, 200, seed)][-1]
                     for seed in range(10)], axis=0)
    assert found[1] > 4 and max(found[0], found[2]) < 0.5


def test_what_interrupts_leaves_the_covariance_as_it_is():
    *_, (noise, state, *_) = frames(np.zeros(3), 60, 1)
    before = noise.ratio
    assert np.linalg.eigvalsh(state.covariance[:6, :6] + noise.excess)[0] > 0
    assert np.diag(noise.excess).max() < 0
    noise.interrupt()
    assert not noise.excess.any() and (noise.ratio == before).all()
