# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitudes as messages of Basilisk: against its own kinematics and flight software."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from startracker_evaluation.gnc.basilisk_messages import (
    MeasurementError, mrp_from_quaternion, navigation_payload, quaternion_from_mrp,
    star_tracker_payload)
from startracker_ros.core.maths.rotation import (
    conjugate, matrix_from_quaternion, multiply, random_attitude)

Q = np.array([0.1, -0.3, 0.5, 0.8]) / np.linalg.norm([0.1, -0.3, 0.5, 0.8])
MANY = [random_attitude(np.random.default_rng(seed)) for seed in range(200)]
MANY += [-q for q in MANY]
TIME_NS = 1_790_000_000_123_456_789


def test_mrp_are_those_of_scipy_and_turn_into_the_same_rotation():
    for q in MANY:
        sigma = mrp_from_quaternion(q)
        assert np.linalg.norm(sigma) <= 1
        assert sigma == pytest.approx(Rotation.from_quat(q).as_mrp(), abs=1e-12)
        assert abs(quaternion_from_mrp(sigma) @ q) == pytest.approx(1, abs=1e-14)


def test_the_shadow_set_of_mrp_is_the_same_rotation():
    sigma = mrp_from_quaternion(Q)
    shadow = -sigma / (sigma @ sigma)
    assert quaternion_from_mrp(shadow) == pytest.approx(Q, abs=1e-14)


def test_matrices_are_those_of_basilisk(basilisk):
    from Basilisk.utilities import RigidBodyKinematics as kinematics
    for q in MANY:
        x, y, z, w = q
        body_from_icrf = matrix_from_quaternion(q).T
        assert kinematics.EP2C([w, x, y, z]) == pytest.approx(body_from_icrf, abs=1e-13)
        assert kinematics.MRP2C(mrp_from_quaternion(q)) == pytest.approx(
            body_from_icrf, abs=1e-13)


def test_the_flight_software_reads_the_attitude_of_the_body_from_the_star_tracker(basilisk):
    from Basilisk.architecture import messaging
    from Basilisk.fswAlgorithms import stComm
    from Basilisk.utilities.SimulationBaseClass import SimBaseClass
    q_body_from_sensor = np.array([0.5, 0.5, 0.5, 0.5])
    message = messaging.STSensorMsg().write(star_tracker_payload(TIME_NS, Q))
    module = stComm.stComm()
    # Named as the matrix to the platform, it is the one that turns the case into the body.
    module.dcm_BP = matrix_from_quaternion(q_body_from_sensor).ravel().tolist()
    module.stSensorInMsg.subscribeTo(message)
    simulation = SimBaseClass()
    simulation.CreateNewProcess('p').addTask(simulation.CreateNewTask('t', 10 ** 9))
    simulation.AddModelToTask('t', module)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(0)
    simulation.ExecuteSimulation()
    read = module.stAttOutMsg.read()
    assert read.timeTag == TIME_NS
    expected = multiply(Q, conjugate(q_body_from_sensor))
    assert abs(quaternion_from_mrp(np.array(read.MRP_BdyInrtl)) @ expected) == pytest.approx(
        1, abs=1e-14)


def test_the_star_tracker_message_keeps_every_bit(basilisk):
    for q in MANY:
        payload = star_tracker_payload(TIME_NS, q)
        assert payload.timeTag == TIME_NS
        assert payload.qInrtl2Case == np.roll(q, 1).tolist()


def test_the_navigation_message(basilisk):
    rate = np.array([0.01, -0.02, 0.03])
    payload = navigation_payload(1_234_567_891, Q, rate)
    assert round(payload.timeTag * 1e9) == 1_234_567_891
    assert quaternion_from_mrp(np.array(payload.sigma_BN)) == pytest.approx(Q, abs=1e-15)
    assert payload.omega_BN_B == rate.tolist()


@pytest.mark.parametrize('time_ns, q, rate, words', [
    (0, [0, 0, 0, 0], [0, 0, 0], 'its norm is not 1'),
    (0, [0, 0, np.nan, 1], [0, 0, 0], 'is not 4 finite numbers'),
    (0, [0, 0, 1], [0, 0, 0], 'is not 4 finite numbers'),
    (0, [0, 0, 0, 1], [0, np.inf, 0], 'rate .* is not 3 finite numbers'),
    (-1, [0, 0, 0, 1], [0, 0, 0], 'before the start')])
def test_what_is_not_an_attitude_becomes_no_message(basilisk, time_ns, q, rate, words):
    with pytest.raises(MeasurementError, match=words):
        navigation_payload(time_ns, np.array(q), np.array(rate))
