# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo command, end to end: a process for each node, a bag that rosbags opens."""

import json
import os
from pathlib import Path
import subprocess
import sys

from commands import invoke
import cv2
from foreign_reader import messages_by_topic, stamp_ns
from geometry_msgs.msg import QuaternionStamped
from limits import HANGS_S
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, read_cloud
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.processes import claim_domain, HarnessError
from startracker_ros.ros.rig import Rig
from startracker_ros.tools.demos import live_demo
from startracker_ros.tools.demos.live_demo import Demo

FRAMES = 50


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    """Run the demo for five seconds of sky time, while another one runs."""
    output = tmp_path_factory.mktemp('demo') / 'demo'
    # What the first demo does; where this fails, somebody else has done so.
    claim_domain(0)
    environment = {name: value for name, value in os.environ.items() if name != 'ROS_DOMAIN_ID'}
    done = subprocess.run(
        [sys.executable, '-m', 'startracker_ros', 'demo', '--seconds', str(FRAMES / 10),
         '--output', str(output), '--json'],
        env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return output, json.loads(done.stdout), done.stderr


def test_every_row_holds(demo):
    """Times of the machine have goals, which decide nothing."""
    _, document, _ = demo
    assert document['name'] == 'demo'
    rows = {row['case']: row for row in document['rows']}
    assert rows['process start to first attitude']['ours'] > 0
    assert all(row['holds'] for row in rows.values()), document
    timed = {case for case, row in rows.items() if row['unit'] in ('s', 'ms')}
    assert not any(rows[case]['bound'] for case in timed)
    assert rows['process start to first attitude']['goal'].startswith('<= 10')
    assert 'steal time' in document['conditions']['machine']
    assert rows['images']['ours'] == FRAMES
    assert rows['frames dropped']['ours'] == 0
    assert rows['wrong attitudes']['ours'] == 0
    assert rows['frames missing in the bag']['ours'] == 0


def test_the_start_names_the_nodes_that_are_ready(demo):
    _, _, progress = demo
    lines = progress.splitlines()
    first_frame = next(i for i, line in enumerate(lines) if 'the first frame' in line)
    for node in ('bag_recorder', 'sky_simulator', *STAGES):
        assert any(line.endswith(f'] {node}: ready') for line in lines[:first_frame]), progress


@pytest.fixture(scope='module')
def messages(demo):
    return messages_by_topic(demo[0] / 'bag')


def test_the_bag_holds_every_message_of_every_frame(messages):
    stamps = {}
    for topic in ('/image_raw', '/centroids', '/tracks', '/truth/attitude',
                  '/truth/stars', '/truth/odometry', '/attitude_imu'):
        stamps[topic] = sorted(stamp_ns(m) for m in messages[topic])
        assert len(stamps[topic]) == FRAMES, topic
        assert stamps[topic] == stamps['/image_raw'], topic
    # The camera is published before the first image, too.
    described = {stamp_ns(m) for m in messages['/camera_info']}
    assert described >= set(stamps['/image_raw'])
    gyro_ns = [stamp_ns(m) for m in messages['/imu']]
    # From when the recorder has found the topic, which on a busy machine takes a while.
    assert abs(gyro_ns[-1] - stamps['/image_raw'][-1]) <= 1
    assert np.abs(np.diff(gyro_ns) - 10_000_000).max() <= 1
    assert messages['/tracker_state'][-1].message == 'TRACKING'
    assert messages['/diagnostics']


def test_most_images_after_the_first_attitude_are_searched_in_windows(messages):
    """Although the recorder subscribes to the target."""
    assert not any(m.width for m in messages['/target_centroid'])
    first_ns = min(stamp_ns(m) for m in messages['/attitude'])
    windowed = [read_cloud(m, CENTROID_DTYPE)['directed'].any()
                for m in messages['/centroids'] if stamp_ns(m) > first_ns]
    assert sum(windowed) > len(windowed) / 2


def test_attitudes_agree_with_the_truth(demo, messages):
    """By SciPy and rosbags alone."""
    _, document, _ = demo
    printed = {row['case']: row['ours'] for row in document['rows']}
    truth = {stamp_ns(m): m.quaternion for m in messages['/truth/attitude']}
    errors, previous = [], None
    for message in messages['/attitude']:
        q = message.quaternion
        ours = np.array([q.x, q.y, q.z, q.w])
        if previous is not None:
            assert ours @ previous > 0, 'the sign of the quaternion jumped'
        previous = ours
        t = truth[stamp_ns(message)]
        error = Rotation.from_quat([t.x, t.y, t.z, t.w]).inv() * Rotation.from_quat(ours)
        errors.append(np.degrees(error.as_rotvec()) * 3600)
        assert message.header.frame_id == 'icrf'
    # When the first one comes depends on the machine; a later frame without has its reason.
    first_ns = min(stamp_ns(m) for m in messages['/attitude'])
    without = printed['later frames without attitude, reason given']
    assert len(errors) + without == sum(stamp >= first_ns for stamp in truth)
    assert len(errors) > without
    errors = np.abs(errors)
    assert errors[:, :2].max() < 10 and errors[:, 2].max() < 100
    assert printed['roll error, rms'] == pytest.approx(
        np.sqrt(np.mean(errors[:, 2] ** 2)), rel=1e-3)


def test_the_picture_shows_stars_and_errors(demo):
    output, _, _ = demo
    blue, green, red = np.moveaxis(cv2.imread(str(output / 'demo.png')).astype(int), -1, 0)
    assert blue.shape[1] > 1000
    # The green marks of identified stars on the left, the blue errors on the right.
    between = blue.shape[1] * 5 // 9
    marks = green - np.maximum(red, blue) > 60
    points = blue - red > 100
    assert marks[:, :between].sum() > 500 and marks[:, between:].sum() < 50
    assert points[:, between:].sum() > 200 and points[:, :between].sum() < 50
    assert Path(output / 'logs' / 'star_tracker.log').read_text().count('TRACKING') >= 1


def test_another_star_tracker_in_the_domain_of_the_user_is_named(tmp_path, monkeypatch):
    # On a busy machine discovery takes longer than a demo waits; it ends with what is found.
    monkeypatch.setattr(live_demo, '_DISCOVERY_S', HANGS_S)
    with Rig(tmp_path) as rig:
        rig.probe.create_publisher(Image, 'image_raw', qos.IMAGE)
        done = invoke('demo', '--output', str(tmp_path / 'demo'))
    assert done.exit_code == 1
    assert '/rig publish in ROS domain' in done.stderr and 'ROS_DOMAIN_ID' in done.stderr


class WaitingDemo(Demo):
    endpoints = {'attitude': (1, 0)}
    needs = {'/attitude_estimator': ()}
    frames = 0

    def table(self, frames):
        raise AssertionError('no node is ready')


def test_another_star_tracker_that_comes_later_is_named(tmp_path):
    with WaitingDemo(tmp_path) as demo:
        for _ in range(2):
            demo.probe.create_publisher(QuaternionStamped, 'attitude', qos.LIST)
        with pytest.raises(HarnessError, match=r'^2 nodes publish attitude in ROS domain \d+, '
                                               r'where the demo has 1: /demo_monitor'):
            demo.await_ready()


def test_a_folder_that_is_not_a_bag_is_not_touched(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'thesis.txt').write_text('years of work')
    done = invoke('demo', '--output', str(tmp_path))
    assert done.exit_code == 1
    assert 'exists and holds no bag' in done.stderr
    assert (tmp_path / 'bag' / 'thesis.txt').read_text() == 'years of work'
