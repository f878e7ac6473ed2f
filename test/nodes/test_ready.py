# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node that is active is ready: of a recording that begins then no frame is lost."""

from contextlib import ExitStack
from pathlib import Path
import subprocess
import sys

from limits import HANGS_S
import numpy as np
import pytest
from queues import deep_queues
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from skies import START_NS
from startracker_evaluation.harness.random_transitions import ACTIVE, NodeManager
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, ns_from_stamp
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.clouds import cloud_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.probe import Progress
from startracker_ros.ros.processes import NodeProcesses

BAGS = Path(__file__).parents[2] / 'bags'
PLAYER = Path(__file__).with_name('replaying.py')
CAMERA = Camera.from_fov(256, 256, 20.0)
LOST = ('dropped', 'missing', 'while not active', 'out of order', 'without', 'before ready')


def play(bag, rate, early):
    """Start a player, in the environment of this process."""
    return subprocess.Popen([sys.executable, str(PLAYER), str(bag), str(rate), str(early)])


def wait_while_it_increases(probe, count, done, player):
    """Wait until done() is true or count() has not increased for a long time."""
    progress = Progress(HANGS_S)
    while not done() and not progress.is_stalled(count()):
        assert not player.poll(), 'the player has failed'
        probe.spin_for(0.1)


def frames_in(bag):
    """Return the stamps of the images of a bag, and how many images are missing between them."""
    stamps_ns = sorted(ns_from_stamp(deserialize_message(message.data, Image).header.stamp)
                       for message in read_messages(bag, topics=('/image_raw',)))
    periods_ns = np.diff(stamps_ns)
    return set(stamps_ns), round((periods_ns / periods_ns.min() - 1).sum())


def lost_frames(probe, missing):
    """Return the counters of lost messages, other than of those missing in the bag."""
    newest = {status.name: status for status in probe.statuses()}
    return {(name, value.key): value.value for name, status in newest.items()
            for value in status.values if any(word in value.key for word in LOST)
            and value.key != 'frames without attitude'
            and int(float(value.value)) != (missing if value.key.endswith('missing') else 0)}


@pytest.mark.parametrize('name, composed, rate, early, busy', [
    ('slew', False, 2.0, 5, 0), ('kidnapped', True, 2.0, 0, 0), *(
        pytest.param(*case, marks=pytest.mark.long) for case in (
            ('slew', True, 1.0, 0, 0), ('kidnapped', False, 1.0, 0, 0),
            ('dropouts', True, 1.0, 0, 0), ('dropouts', False, 1.0, 0, 0),
            ('slew', False, 2.0, 5, 2), ('slew', True, 2.0, 0, 2)))])
def test_every_frame_played_into_active_nodes_is_answered(
        rig, probe, tmp_path, name, composed, rate, early, busy):
    bag = BAGS / name
    frames_ns, missing = frames_in(bag)
    probe.collect(Imu, 'attitude_imu', qos.LIST)
    answers = probe.received['attitude_imu']
    manager = NodeManager(probe)
    with ExitStack() as processes:
        # As a user starts them: nothing is loaded yet.
        nodes = processes.enter_context(NodeProcesses(tmp_path))
        for name in (('composed_pipeline',) if composed else STAGES):
            # How many images wait is of the machine, that none is lost of the nodes.
            nodes.start(name, {'use_sim_time': True, **deep_queues('image_raw.subscription')})
        for name in STAGES:
            probe.wait(lambda name=name: manager.state(name) == ACTIVE, f'{name} active')
        for _ in range(busy):
            loop = processes.enter_context(
                subprocess.Popen([sys.executable, '-c', 'while True: pass']))
            processes.callback(loop.kill)
        player = processes.enter_context(play(bag, rate, early))
        processes.callback(player.kill)
        wait_while_it_increases(
            probe, lambda: len(answers), lambda: len(answers) >= len(frames_ns), player)
        assert {ns_from_stamp(message.header.stamp) for message in answers} == frames_ns
        # The counters of the last frame.
        probe.forget()
        probe.wait(lambda: len({status.name for status in probe.statuses()}) >= 2 * len(STAGES),
                   'diagnostics of all stages')
        assert lost_frames(probe, missing) == {}
        assert player.wait(HANGS_S) == 0
        rig.remove_probe()
        assert set(nodes.stop(HANGS_S).values()) == {0}


def header(index):
    return make_header(START_NS + index * 10 ** 8, 'star_tracker_optical_frame')


def started_tracker(nodes, probe):
    """Start a tracker and return the publishers of its centroids and camera_info."""
    nodes.start('star_tracker')
    probe.collect(PointCloud2, 'tracks', qos.LIST)
    centroids = probe.advertise(PointCloud2, 'centroids', qos.LIST)
    info = probe.advertise(CameraInfo, 'camera_info', qos.LIST)
    probe.wait(lambda: probe.count_publishers('tracks'), 'the tracker')
    return centroids, info


def test_the_newest_lists_wait_for_the_first_camera_info_and_older_ones_are_counted(nodes, probe):
    centroids, info = started_tracker(nodes, probe)
    depth, too_many = qos.LIST.depth, 30
    for index in range(depth + too_many):
        centroids.publish(cloud_to_message(np.zeros(0, CENTROID_DTYPE), header(index)))
        # No more at a time than the queue of the subscription holds.
        probe.spin_once(0.01)
    dropped = f'{too_many}'
    probe.wait(lambda: probe.diagnostic_value(
        'star_tracker: tracking', 'dropped without camera_info') == dropped, 'dropped lists')
    assert not probe.received['tracks']
    probe.publish_until_received(info, camera_to_message(CAMERA, header(0)))
    probe.wait(lambda: len(probe.received['tracks']) >= depth, 'tracks of all that wait')
    assert [ns_from_stamp(message.header.stamp) for message in probe.received['tracks']] == [
        ns_from_stamp(header(index).stamp) for index in range(too_many, depth + too_many)]


def test_what_waits_is_dropped_after_an_invalid_camera_info(nodes, probe):
    centroids, info = started_tracker(nodes, probe)

    def publish(index):
        centroids.publish(cloud_to_message(np.zeros(0, CENTROID_DTYPE), header(index)))

    def wait_for(key, value):
        probe.wait(lambda: probe.diagnostic_value('star_tracker: tracking', key) == value, key)
    publish(0)
    wait_for('centroids received', '1')
    invalid = camera_to_message(CAMERA, header(0))
    invalid.k, invalid.p = [0.0] * 9, [0.0] * 12
    info.publish(invalid)
    wait_for('dropped without camera_info', '1')
    publish(1)
    wait_for('dropped without camera_info', '2')
    info.publish(camera_to_message(CAMERA, header(1)))
    wait_for('camera_info received', '2')
    publish(2)
    probe.wait(lambda: probe.received['tracks'], 'tracks')
    assert [ns_from_stamp(message.header.stamp) for message in probe.received['tracks']] == [
        ns_from_stamp(header(2).stamp)]
