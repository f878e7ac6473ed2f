# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The nodes of the documentation, run as a user runs them."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from queues import deep_queues
from scipy.spatial.transform import Rotation, Slerp
from sensor_msgs.msg import Imu
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / 'docs' / 'examples' / 'listen_attitude.py'
FILTER = ROOT / 'docs' / 'examples' / 'mekf.py'
NOW = ROOT / 'docs' / 'examples' / 'attitude_now.py'


@pytest.fixture
def run_example(nodes):
    """
    Return a function that runs an example with the nodes.

    It ends before them: where two leave at the same time, Fast DDS may spin for ever
    (eProsima/Fast-DDS issue 6513), from which only our nodes have an exit.
    """
    examples = []
    yield lambda path: examples.append(nodes.run(path.stem, [sys.executable, str(path)]))
    for process in examples:
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANGS_S) == 0


def test_listener_prints_attitudes_of_running_nodes(nodes, tmp_path):
    with subprocess.Popen([sys.executable, str(EXAMPLE)], stdout=subprocess.PIPE, text=True,
                          stderr=subprocess.PIPE, env=os.environ) as listener:
        for node in ('centroid_extractor', 'star_identifier', 'star_tracker',
                     'attitude_estimator'):
            nodes.start(node)
        nodes.start('sky_simulator', {'wait_for_subscribers': 1, 'frame_rate_hz': 5.0})
        try:
            for line in listener.stdout:
                if 'worst axis' in line:
                    break
            else:
                pytest.fail('the listener ended without an attitude')
        finally:
            listener.send_signal(signal.SIGINT)
            assert listener.wait(HANGS_S) == 0
            assert listener.stderr.read() == ''
    fields = line.split()
    q = [float(fields[fields.index(name) + 1].rstrip(',')) for name in 'xyzw']
    assert sum(value * value for value in q) == pytest.approx(1, abs=1e-4)
    assert 'arcsec' in line


def test_listener_is_the_one_in_the_readme():
    assert EXAMPLE.read_text().split('"""', 2)[2].strip() in (ROOT / 'README.md').read_text()


def test_listener_is_short():
    code = [line for line in EXAMPLE.read_text().splitlines()
            if line.strip() and not line.startswith('#')]
    assert len(code) <= 22


def test_the_attitude_of_now_is_right_between_the_frames(nodes, probe, run_example):
    truths, answers = (probe.received[topic] for topic in ('truth/attitude', 'attitude_now'))
    probe.collect(Imu, 'attitude_now', qos.IMU)
    probe.collect(QuaternionStamped, 'truth/attitude', qos.LIST)
    run_example(NOW)
    for node in STAGES:
        nodes.start(node, deep_queues('image_raw.subscription'))
    nodes.start('sky_simulator', {
        'wait_for_camera_users': 4, 'frame_rate_hz': 5.0, 'width': 512, 'height': 512,
        'motion': 'constant_rate', 'rate_deg_s': (0.1, 0.3, -0.2)})

    def compared():
        """Return attitudes between two true ones of a constant rate, with the true one."""
        if len(truths) < 2:
            return []
        stamps_ns = np.array([ns_from_stamp(message.header.stamp) for message in truths])
        true = Slerp(stamps_ns - stamps_ns[0], Rotation.from_quat(
            [quaternion_from_message(message) for message in truths]))
        return [(tracked_attitude_from_imu(message).attitude, true(at_ns - stamps_ns[0]).as_quat())
                for message in answers
                if stamps_ns[0] < (at_ns := ns_from_stamp(message.header.stamp)) < stamps_ns[-1]]
    probe.wait(lambda: len(compared()) >= 30, 'attitudes')
    for attitude, truth in compared():
        sigma_rad = np.sqrt(np.diag(attitude.covariance_sensor))
        assert np.all(np.abs(attitude_error(attitude.quaternion, truth)) < 5 * sigma_rad)


def test_the_filter_is_consistent_below_the_floor_of_robot_localization(
        nodes, probe, run_example):
    for message_type, topic, profile in (
            (Imu, 'attitude_filtered', qos.IMU), (QuaternionStamped, 'truth/attitude', qos.LIST)):
        probe.collect(message_type, topic, profile)
    run_example(FILTER)
    for node in STAGES[:-1]:
        nodes.start(node, deep_queues('image_raw.subscription'))
    nodes.start('sky_simulator', {'wait_for_camera_users': 3, 'frame_rate_hz': 5.0,
                                  'gyro_rate_hz': 20.0, 'width': 512, 'height': 512})
    filtered = {}

    def compared():
        for message in probe.received['attitude_filtered']:
            filtered[ns_from_stamp(message.header.stamp)] = message
        truth = {ns_from_stamp(message.header.stamp): quaternion_from_message(message)
                 for message in probe.received['truth/attitude']}
        return [(tracked_attitude_from_imu(filtered[stamp_ns]).attitude, truth[stamp_ns])
                for stamp_ns in sorted(filtered.keys() & truth.keys())]
    probe.wait(lambda: len(compared()) >= 25, 'filtered attitudes')
    for attitude, truth in compared():
        error_rad = attitude_error(attitude.quaternion, truth)
        sigma_rad = np.sqrt(np.diag(attitude.covariance_sensor))
        assert np.all(np.abs(error_rad) < 5 * sigma_rad)
    # Cross-boresight; its EKF knows no variance below this one.
    assert np.all(sigma_rad[:2] < 6.5 * ARCSEC)
