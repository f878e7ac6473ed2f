# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loop around Basilisk, with a star tracker that reports the truth or worse."""

from pathlib import Path

import numpy as np
from pictures import assert_legible
import pytest
from startracker_evaluation.gnc.camera import FrameFault, Observation
from startracker_evaluation.gnc.history import draw, History, rows_of
from startracker_evaluation.gnc.loop import ClosedLoop
from startracker_evaluation.gnc.navigation import Navigation
from startracker_evaluation.gnc.plan import Phase, Plan, PlanOptions
from startracker_evaluation.gnc.spacecraft import LATENCY_NS, Spacecraft, SpacecraftOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, matrix_from_quaternion, multiply, quaternion_from_rotation_vector, random_attitude)

SIGMA = np.array([1.0, 1.0, 10.0]) * ARCSEC
PLAN = PlanOptions(acquire_s=5.0, slew_rad=np.radians(10.0), settle_s=50.0, fine_s=10.0,
                   blinded_s=10.0, recovered_s=10.0)
WHEELS = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1]]) / np.sqrt(3)
WHEEL_INERTIA = 4.0 / (6000 * np.pi / 30)
TURNED_AWAY = quaternion_from_rotation_vector(np.radians([3.0, 0.0, 0.0]))


class TruthfulCamera:
    """Reports the truth with noise; for a second from wrong_s on it is 3 deg off."""

    def __init__(self, wrong_s=np.inf):
        self._rng = np.random.default_rng(1)
        self._wrong_s = wrong_s

    def observe(self, time_ns, motion, fault):
        if fault.blinded:
            return Observation('LOST')
        state = motion.at(time_ns * 1e-9)
        q = multiply(state.q_icrf_from_sensor, quaternion_from_rotation_vector(
            self._rng.normal(0, SIGMA)))
        if 0 <= time_ns * 1e-9 - self._wrong_s < 0.9:
            q = multiply(q, TURNED_AWAY)
        return Observation('TRACKING', q, np.diag(SIGMA ** 2), state.rate_rad_s)


def make_loop(camera, fault_of=lambda time_s: FrameFault(), options=SpacecraftOptions()):
    spacecraft = Spacecraft(random_attitude(np.random.default_rng(2)),
                            np.radians([2.0, -1.5, 1.6]), options)
    return ClosedLoop(spacecraft, camera, Navigation(np.array(options.inertia_kg_m2)),
                      Plan(PLAN), fault_of)


@pytest.fixture(scope='module')
def history(basilisk):
    # Unequal friction: that of equal wheels cancels. The integral of the controller holds it.
    options = SpacecraftOptions(coulomb_n_m=(0.002, 0.0005, 0.001, 0.0))
    loop, steps = make_loop(TruthfulCamera(), options=options), []
    while not loop.plan.finished:
        steps.append(loop.step())
    return History(steps, loop.plan)


@pytest.mark.slow
def test_it_goes_from_tumbling_through_all_phases(history):
    assert list(history.plan.begins_s) == list(Phase)
    assert history.in_control
    assert history.wrong == 0


def test_it_points_within_the_noise_of_the_star_tracker(history):
    assert (history.fine_rms_arcsec[:2] < 2.0).all()
    assert history.settle_s < 60


def test_the_attitude_is_held_while_there_is_none(history):
    # The frame of the change still has the light of the phase before.
    dark = history.within(Phase.BLINDED)
    dark[np.flatnonzero(dark)[0]] = False
    assert not history.used[dark].any()
    assert history.hold_s[dark].max() == pytest.approx(PLAN.blinded_s, abs=0.5)
    assert np.abs(history.boresight_arcsec()[dark]).max() < 60
    assert history.recovery_s <= 0.4


def test_the_figures_hold_and_can_be_drawn(history, tmp_path):
    rows = {row.case: row for row in rows_of(history)}
    assert all(row.holds for row in rows.values())
    assert rows['longest hold by propagation'].ours == pytest.approx(10.0, abs=0.5)
    draw(tmp_path / 'loop.png', history, 'loop')
    assert (tmp_path / 'loop.png').stat().st_size > 10_000


def test_the_phases_and_all_texts_are_legible_in_the_picture(history, monkeypatch):
    figures = []
    monkeypatch.setattr('startracker_ros.tools.report.chart.write_picture',
                        lambda path, figure, **options: figures.append(figure))
    draw(Path('loop.png'), history, 'loop')
    assert_legible(figures[0])


def test_the_navigation_predicts_what_basilisk_integrates(basilisk):
    loop = make_loop(TruthfulCamera())
    steps = [loop.step() for _ in range(12)]
    inertia = np.array(SpacecraftOptions().inertia_kg_m2)
    for before, after in zip(steps[1:], steps[2:]):
        torques = [-WHEELS @ step.truth.torque_n_m for step in (before, after)]
        momentum = WHEELS @ (after.truth.wheel_rad_s * WHEEL_INERTIA)
        navigation = Navigation(inertia)
        begin, end = before.truth, after.truth
        navigation.correct(begin.time_ns, begin.q_icrf_from_body, np.eye(3) * 1e-12,
                           begin.rate_rad_s)
        navigation.propagate(begin.time_ns + LATENCY_NS, torques[0], momentum)
        navigation.propagate(end.time_ns, torques[1], momentum)
        change = np.linalg.norm(end.rate_rad_s - begin.rate_rad_s)
        assert change > np.radians(0.02)
        missed = np.linalg.norm(navigation.state.rate_rad_s - end.rate_rad_s)
        assert missed < 0.02 * change


def test_momentum_is_exchanged_with_the_wheels_and_kept(basilisk):
    loop = make_loop(TruthfulCamera())
    inertia = np.diag(SpacecraftOptions().inertia_kg_m2)
    total = []
    for _ in range(60):
        truth = loop.step().truth
        body = inertia @ truth.rate_rad_s + WHEELS @ (truth.wheel_rad_s * WHEEL_INERTIA)
        total.append(matrix_from_quaternion(truth.q_icrf_from_body) @ body)
    assert np.linalg.norm(inertia @ truth.rate_rad_s) < 0.1 * np.linalg.norm(total[0])
    assert total == pytest.approx(np.tile(total[0], (60, 1)), abs=2e-3)


def test_an_attitude_that_is_wrong_for_a_second_is_never_used(basilisk):
    loop = make_loop(TruthfulCamera(wrong_s=20.0))
    steps = [loop.step() for _ in range(200)]
    history = History(steps, loop.plan)
    assert history.wrong == 0
    # In five frames of that second; none before, while it tumbled.
    assert loop.navigation.rejected == 5


def test_without_a_star_tracker_the_rate_is_damped_and_nothing_else_begins(basilisk):
    loop = make_loop(TruthfulCamera(), lambda time_s: FrameFault(dropped=True))
    steps = [loop.step() for _ in range(200)]
    assert steps[-1].phase is Phase.ACQUIRE
    assert loop.navigation.state is None
    assert np.degrees(np.linalg.norm(steps[-1].truth.rate_rad_s)) < 0.05
