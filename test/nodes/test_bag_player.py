# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""bag_player as a process: bags of others, whole and cut, with their quality of service."""

import os
from pathlib import Path
import re
import subprocess
import sys

from geometry_msgs.msg import PoseWithCovarianceStamped
from limits import HANGS_S
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros.executables import STAGES
from std_msgs.msg import String
from std_srvs.srv import Trigger

START_NS = 1_700_000_000_000_000_000
COUNT = 40
INFINITE = QosTime(9223372036, 854775807)
STATE_QOS = Qos(QosHistory.KEEP_LAST, 7, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
                INFINITE, INFINITE, QosLiveliness.AUTOMATIC, INFINITE, False)
FAST_QOS = Qos(QosHistory.UNKNOWN, 0, QosReliability.BEST_EFFORT, QosDurability.VOLATILE,
               INFINITE, INFINITE, QosLiveliness.AUTOMATIC, INFINITE, False)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def write_bag(folder: Path, *, version: int = 9, mode: CompressionMode | None = None) -> None:
    """Write a bag with rosbags: two topics at 50 Hz each, one of a type that is not installed."""
    store = get_typestore(Stores.ROS2_JAZZY)
    text = store.types['std_msgs/msg/String']
    writer = Writer(folder, version=version, storage_plugin=StoragePlugin.MCAP)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer as bag:
        state, fast = (bag.add_connection(topic, 'std_msgs/msg/String', typestore=store,
                                          offered_qos_profiles=[qos])
                       for topic, qos in (('/state', STATE_QOS), ('/fast', FAST_QOS)))
        odd = bag.add_connection('/odd', 'no_msgs/msg/Such', msgdef='int32 x\n',
                                 rihs01=f'RIHS01_{64 * "0"}')
        for number in range(COUNT):
            for connection, prefix in ((state, 's'), (fast, 'f')):
                time_ns = START_NS + number * 20_000_000 + (connection is fast)
                bag.write(connection, time_ns, store.serialize_cdr(
                    text(f'{prefix}{number}'), 'std_msgs/msg/String'))
            bag.write(odd, START_NS + number * 20_000_000, b'\0\1\0\0\1\0\0\0')


STATES = [f's{number}' for number in range(COUNT)]
# On a busy machine discovery takes longer than the player waits by default.
PATIENT = {'wait_limit_s': HANGS_S}


def texts(probe, topic):
    return [message.data for message in probe.received[topic]]


def wait_played(probe, player, topic, expected):
    """Wait for the end of a player and for the last of its messages."""
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    assert player.returncode == 0
    probe.wait(lambda: texts(probe, topic)[-1:] == expected[-1:], 'the last message')
    assert texts(probe, topic) == expected


def assert_some_in_order(found, expected):
    """Compare what best effort has brought."""
    assert found and found == [text for text in expected if text in found]


def ask(probe, name):
    return probe.call(Trigger, f'/bag_player/{name}', Trigger.Request())


@pytest.mark.parametrize('version, mode, override, reliability', [
    (9, CompressionMode.STORAGE, {}, ReliabilityPolicy.RELIABLE),
    (8, CompressionMode.MESSAGE, {'qos_overrides./fast.publisher.reliability': 'best_effort'},
     ReliabilityPolicy.BEST_EFFORT)],
    ids=['chunks compressed', 'messages compressed'])
def test_a_bag_of_rosbags_is_played_reliably_and_as_durable_as_it_was_recorded(
        nodes, probe, tmp_path, version, mode, override, reliability):
    write_bag(tmp_path / 'bag', version=version, mode=mode)
    probe.collect(Clock, '/clock', BEST_EFFORT)
    probe.collect(String, '/state', LATCHED)
    probe.collect(String, '/fast', BEST_EFFORT)
    player = nodes.start('bag_player', {'path': str(tmp_path / 'bag'), 'start_paused': True,
                                        **override, **PATIENT})
    probe.wait(lambda: probe.count_publishers('/fast') and probe.count_publishers('/state'),
               'the player')
    state, = probe.get_publishers_info_by_topic('/state')
    fast, = probe.get_publishers_info_by_topic('/fast')
    assert state.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert state.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert fast.qos_profile.durability == DurabilityPolicy.VOLATILE
    assert fast.qos_profile.reliability == reliability
    assert not probe.count_publishers('/odd')
    assert ask(probe, 'resume').success
    wait_played(probe, player, '/state', STATES)
    assert_some_in_order(texts(probe, '/fast'), [f'f{number}' for number in range(COUNT)])
    clock_ns = [ns_from_stamp(message.clock) for message in probe.received['/clock']]
    assert clock_ns == sorted(clock_ns) and clock_ns
    assert START_NS <= clock_ns[0] <= clock_ns[-1] <= START_NS + COUNT * 20_000_000
    log = (tmp_path / 'bag_player.log').read_text()
    assert '/odd is not played: no_msgs/msg/Such is not installed' in log
    assert re.search(rf'{2 * COUNT} messages of 2 topics; late by \S+ ms median, \S+ ms p95', log)


def test_subscribers_that_wait_miss_nothing(nodes, probe, tmp_path):
    """Discovery is limited to this machine, where it takes longer than a second."""
    write_bag(tmp_path / 'bag')
    probe.collect(String, '/state', 100)
    probe.collect(String, '/fast', BEST_EFFORT)
    player = nodes.start('bag_player', {'path': str(tmp_path / 'bag'), **PATIENT})
    wait_played(probe, player, '/state', STATES)
    assert texts(probe, '/fast')


def test_what_latched_topics_held_at_the_offset_is_played_first(nodes, probe, tmp_path):
    write_bag(tmp_path / 'bag')
    player = nodes.start('bag_player', {
        'path': str(tmp_path / 'bag'), 'start_offset_s': 0.5, 'latched': True,
        'start_paused': True, 'wait_for_subscribers': 0})
    probe.wait(lambda: probe.count_publishers('/state'), 'the player')
    # The subscriber comes late, and the volatile topic has said nothing.
    probe.collect(String, '/fast', BEST_EFFORT)
    probe.collect(String, '/state', LATCHED)
    held = [f's{number}' for number in range(18, 25)]
    probe.wait(lambda: texts(probe, '/state') == held, 'the last seven before the offset')
    assert texts(probe, '/fast') == []
    assert ask(probe, 'resume').success
    wait_played(probe, player, '/state', STATES[18:])


def test_without_subscribers_the_bag_is_played_after_the_limit(nodes, probe, tmp_path):
    write_bag(tmp_path / 'bag')
    probe.collect(String, '/state', 100)
    player = nodes.start('bag_player', {
        'path': str(tmp_path / 'bag'), 'wait_for_subscribers': 2, 'wait_limit_s': 1.0})
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    assert player.returncode == 0
    log = (tmp_path / 'bag_player.log').read_text()
    assert 'waiting for subscribers of' in log
    assert 'played without all subscribers of' in log and '/fast' in log
    assert f'{2 * COUNT} messages of 2 topics' in log


def test_a_bag_that_is_gone_before_it_is_played_is_a_failure(nodes, probe, tmp_path):
    write_bag(tmp_path / 'bag')
    player = nodes.start('bag_player', {
        'path': str(tmp_path / 'bag'), 'wait_for_subscribers': 1, **PATIENT})
    probe.wait(lambda: probe.count_publishers('/state'), 'the player')
    next((tmp_path / 'bag').glob('*.mcap')).unlink()
    probe.collect(String, '/state', 100)
    probe.collect(String, '/fast', BEST_EFFORT)
    probe.wait(lambda: player.poll() is not None, 'the end of the player')
    assert nodes.processes.pop('bag_player').returncode == 1
    assert "'bag.mcap' is not there" in (tmp_path / 'bag_player.log').read_text()


def test_pause_step_resume_and_a_node_on_the_time_of_the_bag(nodes, probe, tmp_path):
    write_bag(tmp_path / 'bag')
    probe.collect(String, '/renamed', LATCHED)
    nodes.start('attitude_estimator', {'use_sim_time': True})
    probe.wait(lambda: probe.count_publishers('attitude'), 'a node with use_sim_time')
    nodes.start('bag_player', {
        'path': str(next((tmp_path / 'bag').glob('*.mcap'))), 'start_paused': True, 'rate': 0.4,
        'topics': ['/state'], 'loop': True, **PATIENT}, ['-r', '/state:=/renamed'])
    probe.wait(lambda: probe.count_publishers('/renamed'), 'the player')
    probe.wait_diagnostic('paused')
    assert texts(probe, '/renamed') == []
    for steps in (1, 2):
        assert ask(probe, 'step').success
        probe.wait(lambda steps=steps: len(texts(probe, '/renamed')) >= steps, 'the next message')
    seen = len(texts(probe, '/renamed'))
    probe.spin_for(0.5)
    assert texts(probe, '/renamed') == [f's{number}' for number in range(seen)]
    ask(probe, 'resume')
    assert not ask(probe, 'step').success
    # The whole bag takes two seconds; then it restarts.
    probe.wait(lambda: texts(probe, '/renamed').count('s0') >= 2, 'the second time round')
    first_round = texts(probe, '/renamed')[:COUNT]
    assert first_round == STATES
    ask(probe, 'pause')
    # What was published before the second answer has come before it.
    ask(probe, 'pause')
    probe.spin_for(0.5)
    seen = len(texts(probe, '/renamed'))
    probe.spin_for(0.5)
    assert len(texts(probe, '/renamed')) == seen
    stamps_ns = [ns_from_stamp(array.header.stamp) for array in probe.received['/diagnostics']
                 if array.status[0].name.startswith('attitude_estimator')]
    on_time = [stamp_ns for stamp_ns in stamps_ns
               if START_NS <= stamp_ns <= START_NS + COUNT * 20_000_000]
    assert len(on_time) >= 1


def play(*arguments):
    return subprocess.run([sys.executable, '-m', 'startracker_ros', 'play',
                           *map(str, arguments)], capture_output=True, text=True,
                          timeout=HANGS_S, env=dict(os.environ))


def test_what_is_whole_of_a_cut_bag_is_played(nodes, probe, tmp_path):
    write_bag(tmp_path / 'bag', mode=CompressionMode.STORAGE)
    whole = next((tmp_path / 'bag').glob('*.mcap')).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(whole[:-200])
    probe.collect(String, '/state', LATCHED)
    player = nodes.start('bag_player', {'path': str(cut), 'start_paused': True,
                                        'wait_for_subscribers': 0})
    probe.wait(lambda: probe.count_publishers('/state'), 'the player')
    assert ask(probe, 'resume').success
    wait_played(probe, player, '/state', STATES)
    assert re.search(r'cut.mcap was not finished: .* whole records end at byte \d+ of '
                     f'{len(whole) - 200}', (tmp_path / 'bag_player.log').read_text())


# A bag that cannot be read is status 1, one that has nothing to play a wrong use of the command.
@pytest.mark.parametrize('content, words, status', [
    (b'SQLite format 2\0', "is not an MCAP file: it starts with b'SQLite f'", 1),
    (b'SQLite format 3\0', 'is damaged: file is not a database', 1),
    (b'\x89MCAP0\r\n', 'nothing to play among no topics', 2)])
def test_what_is_not_a_bag_is_refused(tmp_path, content, words, status):
    (tmp_path / 'file.mcap').write_bytes(content)
    done = play(tmp_path / 'file.mcap')
    assert done.returncode == status
    assert words in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr


def test_patterns_that_choose_nothing_and_topics_that_cannot_be_played_are_named(tmp_path):
    write_bag(tmp_path / 'bag')
    for pattern, words in (
            ('state?', r"/state: topics = \['state\?'\] without exclude = \[.*\] fits none"),
            ('odd', '/state: /odd is not played: no_msgs/msg/Such is not installed')):
        done = play(tmp_path / 'bag', '--topic', pattern)
        assert done.returncode == 2
        assert re.search(f'nothing to play among /fast, /odd, {words}', done.stderr), done.stderr
    done = play(tmp_path / 'bag', '--start-offset-s', '9')
    assert done.returncode == 1
    assert 'nothing was played: no message from 9 s on; the bag ends at 0.78' in done.stderr


def test_a_golden_bag_drives_the_pipeline(nodes, probe):
    bag = Path(__file__).parents[2] / 'bags' / 'slew'
    truth = dict(attitudes_of(bag, '/truth/attitude'))
    for node in STAGES:
        nodes.start(node)
    probe.collect(PoseWithCovarianceStamped, 'attitude_cov', 100)
    probe.wait(lambda: probe.count_publishers('attitude_cov')
               and probe.count_subscribers('camera_info') == len(STAGES), 'the pipeline')
    ready = []
    probe.create_subscription(PointCloud2, 'centroids', lambda message: ready or ready.append({
        status.name.partition(':')[0] for status in probe.statuses()
        if any(value.key == 'camera' for value in status.values)}), 100)
    nodes.start('bag_player', {'path': str(bag), 'loop': True, 'rate': 2.0, **PATIENT,
                               'topics': ['/image_raw', '/camera_info', '/imu']})
    probe.wait(lambda: len(probe.received['attitude_cov']) >= 20, 'attitudes')
    # It plays when the stages are set up for the camera of the bag.
    assert ready[0] == set(STAGES)
    poses = probe.received['attitude_cov']
    assert {ns_from_stamp(pose.header.stamp) for pose in poses} <= truth.keys()
    for pose in poses:
        q = pose.pose.pose.orientation
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
        error = (turn * Rotation.from_quat(truth[ns_from_stamp(pose.header.stamp)]).inv()
                 ).as_rotvec()
        covariance = np.reshape(pose.pose.covariance, (6, 6))[3:, 3:]
        assert error @ np.linalg.solve(covariance, error) < 5 ** 2


def attitudes_of(bag, topic):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, data in reader.messages(wanted):
            message = store.deserialize_cdr(data, connection.msgtype)
            q = message.quaternion
            yield (message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec,
                   [q.x, q.y, q.z, q.w])


@pytest.mark.parametrize('topics, named', [
    (('*/image_raw',), True), (('*/image_raw', '*/camera_info'), False),
    pytest.param(('*/imu',), False, marks=pytest.mark.long)])
def test_images_without_a_camera_are_named(nodes, probe, tmp_path, topics, named):
    bag = Path(__file__).parents[2] / 'bags' / 'slew'
    player = nodes.start('bag_player', {'path': str(bag), 'topics': topics, 'rate': 100.0})
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    log = (tmp_path / 'bag_player.log').read_text()
    assert (f'{bag}: images without camera_info: the stages wait for one' in log) == named
