# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A real attitude_fusion between two heads and a gyro that a test plays."""

from geometry_msgs.msg import (
    PoseWithCovarianceStamped, QuaternionStamped, TwistWithCovarianceStamped)
from limits import HANGS_S
import numpy as np
import pytest
from sensor_msgs.msg import Imu, Temperature
from startracker_evaluation.campaign.heads_scene import head_mounts, START_NS
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.fusion.mounts import load_mounts, Mount, save_mounts
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, multiply, turned
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import (
    attitude_to_imu, hint_from_imu, quaternion_from_message)
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from std_srvs.srv import Trigger

HEADS = ('tracker_1', 'tracker_2')
RATE = np.radians([0.1, -0.05, 0.02])
Q0 = np.array([0.5, -0.1, 0.7, 0.5])
COVARIANCE = np.diag([1.0, 1.0, 100.0]) * ARCSEC ** 2


class Body:
    """Publishers of two heads and a gyro, a frame of each every 0.2 s."""

    def __init__(self, probe):
        self.probe, self.time_s, self.mounts = probe, 0.0, head_mounts(2)
        # As deep as imu: on a busy machine the node may stop for seconds.
        self.heads = [probe.advertise(Imu, f'{name}/frame_attitude', qos.IMU) for name in HEADS]
        self.imu = probe.advertise(Imu, 'imu', qos.IMU)

    def truth(self, time_s):
        return turned(Q0 / np.linalg.norm(Q0), RATE * time_s)

    def stamp_ns(self, time_s):
        return START_NS + round(time_s * 1e9)

    def send(self, head, *, error=(0.0, 0.0, 0.0), later_s=0.0, quaternion=None):
        q = turned(self.truth(self.time_s), np.array(error))
        q = multiply(q, self.mounts[head]) if quaternion is None else np.array(quaternion)
        self.heads[head].publish(attitude_to_imu(
            AttitudeEstimate(q, COVARIANCE, 0, np.empty(0), 0.0),
            make_header(self.stamp_ns(self.time_s + later_s), 'optical')))

    def run(self, frames, heads=(0, 1), **other):
        for _ in range(frames):
            for _ in range(4):
                self.time_s += 0.05
                self.imu.publish(gyro_to_imu(RATE, 1e-5, make_header(
                    self.stamp_ns(self.time_s), 'gyro')))
            # Two topics have no order between them.
            self.probe.spin_for(0.02)
            for head in heads:
                self.send(head, **other)
            self.probe.spin_for(0.02)

    def run_until(self, text, also=lambda: None, **other):
        """Go on, with something else in each frame, until a diagnostic has a text."""
        def send():
            self.run(1, **other)
            also()
        self.probe.send_until(send, lambda: self.probe.find_diagnostic(text), text, period_s=0.0)

    def run_until_attitude(self, **other):
        """Go on until there is an attitude of a frame from now on, and return it."""
        begin_ns = self.stamp_ns(self.time_s)
        return self.probe.send_until(
            lambda: self.run(1, **other), lambda: next(
                (message for message in self.probe.received['attitude']
                 if ns_from_stamp(message.header.stamp) > begin_ns), None),
            'an attitude', period_s=0.0)

    def newest_attitude_ns(self):
        """Return the newest stamp of an attitude."""
        return max(ns_from_stamp(m.header.stamp) for m in self.probe.received['attitude'])


@pytest.fixture
def body(nodes, probe, tmp_path):
    mounts = {name: Mount(q) for name, q in zip(HEADS, head_mounts(2))}
    save_mounts(mounts, tmp_path / 'mounts.yaml')
    nodes.start('attitude_fusion', {
        'mounts_file': str(tmp_path / 'mounts.yaml'),
        'output_file': str(tmp_path / 'estimated.yaml'),
        **{f'qos_overrides./{name}/frame_attitude.subscription.depth': qos.IMU.depth
           for name in HEADS}})
    for kind, topic in ((QuaternionStamped, 'attitude'), (Imu, 'attitude_imu'),
                        (PoseWithCovarianceStamped, 'attitude_cov'),
                        (PoseWithCovarianceStamped, 'tracker_2/mount'), (Imu, 'tracker_2/hint'),
                        (TwistWithCovarianceStamped, 'gyro_drift')):
        probe.collect(kind, topic, qos.STATE if 'mount' in topic else qos.LIST)
    return Body(probe)


def test_two_heads_give_the_attitude_of_the_body_and_faults_are_named(body, probe, tmp_path):
    body.run(10)
    attitude = body.run_until_attitude()
    assert attitude.header.frame_id == 'icrf'
    time_s = (ns_from_stamp(attitude.header.stamp) - START_NS) * 1e-9
    assert np.linalg.norm(attitude_error(
        quaternion_from_message(attitude), body.truth(time_s))) < ARCSEC
    body.run_until('publishing attitude')
    imu = probe.received['attitude_imu'][-1]
    assert imu.header.frame_id == 'base_link'
    rate = imu.angular_velocity
    np.testing.assert_allclose([rate.x, rate.y, rate.z], RATE, atol=1e-4)
    assert 0 < imu.orientation_covariance[0] < (5 * ARCSEC) ** 2
    pose = probe.received['attitude_cov'][-1].pose
    assert np.any(pose.covariance) and not np.any(np.reshape(pose.covariance, (6, 6))[:3])
    probe.wait(lambda: probe.received['gyro_drift'] and probe.received['tracker_2/mount'],
               'drift and mount')
    # What is not an attitude, and what is not a temperature.
    body.run_until('is not an attitude', heads=(0,), also=lambda: body.send(
        1, quaternion=[0.0, 0.0, 0.0, np.nan]))
    temperature = probe.advertise(Temperature, 'tracker_1/temperature', qos.LIST)
    body.run_until('nan degC is not a temperature', also=lambda: temperature.publish(
        Temperature(temperature=float('nan'))))
    # Frames of a head that come 2 s late.
    body.run_until('frames 2.0 s behind the other heads', heads=(0,),
                   also=lambda: body.send(1, later_s=-2.0))
    # A head that disagrees is named, and the other goes on.
    body.run(8, heads=(0,))
    body.run_until('publishing attitude; tracker_2 excluded: 1 deg from', heads=(0,),
                   also=lambda: body.send(1, error=(0.0, 0.0, 0.0175)))
    body.run_until_attitude(heads=(0,))
    hint = hint_from_imu(probe.wait(
        lambda: probe.received['tracker_2/hint'], 'a hint for the head that does not count')[-1])
    truth = multiply(body.truth((hint.stamp_ns - START_NS) * 1e-9), body.mounts[1])
    error = attitude_error(hint.quaternion, truth)
    assert error @ np.linalg.solve(hint.covariance, error) < 25
    assert np.linalg.norm(error) < 30 * ARCSEC
    answer = probe.call(Trigger, '/attitude_fusion/save_mounts', Trigger.Request())
    assert answer.success and 'estimated.yaml' in answer.message
    assert load_mounts(tmp_path / 'estimated.yaml', HEADS)['tracker_2'].covariance is not None
    # Neither head is in use after a reset, and one is not enough.
    assert probe.call(Trigger, '/attitude_fusion/reset', Trigger.Request()).success
    reset_ns = body.stamp_ns(body.time_s)
    probe.send_until(lambda: body.run(1, heads=(0,)), lambda: probe.received['attitude_imu'][
        -1].orientation_covariance[0] == -1, 'an invalid attitude', period_s=0.0)
    body.run(4, heads=(0,))
    # A head whose tracker identifies nothing: mirrored, or with another focal length.
    body.run_until('tracker_2 waiting: its tracker has no attitude', heads=(0,),
                   also=lambda: body.heads[1].publish(attitude_to_imu(None, make_header(
                       body.stamp_ns(body.time_s), 'optical'))))
    # Two heads with the mount of one.
    body.run_until(
        'no attitude: tracker_1 and tracker_2 disagree by 120 deg', heads=(0,),
        also=lambda: body.send(1, quaternion=multiply(
            body.truth(body.time_s), body.mounts[0])))
    assert body.newest_attitude_ns() <= reset_ns
    # A clock that is 0.2 s slow: 82 arcsec at this rate.
    body.run(10)
    body.run_until_attitude()
    body.run_until('publishing attitude; tracker_2 excluded: 0.02', heads=(0,),
                   also=lambda: body.send(1, later_s=-0.2))
    body.run_until_attitude(heads=(0,))


def test_a_start_that_cannot_be_is_named(nodes, tmp_path):
    (tmp_path / 'mounts.yaml').write_text('heads: {tracker_1: {quaternion: [0, 0, 0, 1]}}')
    process = nodes.start('attitude_fusion', {'mounts_file': str(tmp_path / 'mounts.yaml')})
    assert process.wait(HANGS_S) == 2
    log = (tmp_path / 'attitude_fusion.log').read_text()
    assert 'no mount of tracker_2' in log and 'Traceback' not in log
    nodes.processes.clear()
    process = nodes.start('attitude_fusion', {'heads': ['tracker_1', 'tracker_1']})
    assert process.wait(HANGS_S) == 2
    assert 'must be different namespaces' in (tmp_path / 'attitude_fusion.log').read_text()
    nodes.processes.clear()
