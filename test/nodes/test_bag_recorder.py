# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""bag_recorder as a process: what it hears is in the bag, whatever happens to it."""

from collections import defaultdict
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from limits import HANGS_S
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import Imu
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros import qos
from std_msgs.msg import Header, String

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def wait_recorded(probe, publisher):
    """Wait until the recorder has matched a publisher."""
    probe.wait(publisher.get_subscription_count, f'the recorder at {publisher.topic_name}')


def recorded(bag):
    """Return by topic the messages of a bag as rosbags reads them, and what was offered."""
    found = defaultdict(list)
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        offers = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        for connection, _, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found[connection.topic].append(
                message.data if connection.msgtype == 'std_msgs/msg/String' else message)
    return found, offers


def send(publisher, texts):
    for text in texts:
        publisher.publish(String(data=text))
        time.sleep(0.01)


def messages(probe):
    """Return how many messages the recorder has written."""
    return int(probe.diagnostic_value('bag_recorder: recording', 'messages') or 0)


def test_topics_are_found_as_they_appear_with_the_quality_they_offer(nodes, probe, tmp_path):
    state = probe.create_publisher(String, '/a/state', LATCHED)
    send(state, ['before the recorder'])
    nodes.start('bag_recorder', {
        'folder': str(tmp_path / 'bag'), 'topics': ['/a/*', '/late'], 'exclude': ['*/secret'],
        'compression': 'zstd'})
    secret = probe.create_publisher(String, '/a/secret', 10)
    fast = probe.create_publisher(String, '/a/fast', BEST_EFFORT)
    for publisher in (state, fast):
        wait_recorded(probe, publisher)
    texts = [f'message {number}' for number in range(30)]
    send(fast, texts)
    # Of best effort some may be lost, not all.
    probe.send_until(lambda: send(fast, texts[-1:]), lambda: messages(probe) >= 2,
                     'what was sent before the recorder, and with best effort')
    send(secret, ['not to be recorded'])
    late = probe.create_publisher(Header, '/late', 10)
    wait_recorded(probe, late)
    late.publish(Header(frame_id='late'))
    # A second publisher that offers less: the recorder hears both.
    poor = probe.create_publisher(String, '/a/state', BEST_EFFORT)
    wait_recorded(probe, poor)

    def is_recorded(topic, *last):
        """Return whether a topic is in what has reached the disk."""
        return any(message.topic == topic and all(text in bytes(message.data) for text in last)
                   for message in read_messages(tmp_path / 'bag', tolerant=True))
    probe.send_until(lambda: send(poor, ['of the second']),
                     lambda: is_recorded('/a/state', b'of the second') and is_recorded('/late'),
                     'messages of both')
    assert nodes.stop(HANGS_S) == {'bag_recorder': 0}
    found, offers = recorded(tmp_path / 'bag')
    assert found['/a/fast'] and set(found['/a/fast']) <= set(texts)
    assert [header.frame_id for header in found['/late']] == ['late']
    assert found['/a/state'][0] == 'before the recorder'
    assert found['/a/state'][-1] == 'of the second'
    assert set(offers) == {'/a/state', '/a/fast', '/late'}
    assert offers['/a/fast'][0].reliability == QosReliability.BEST_EFFORT
    assert offers['/a/state'][0].durability == QosDurability.TRANSIENT_LOCAL
    assert offers['/late'][0].reliability == QosReliability.RELIABLE
    log = (tmp_path / 'bag_recorder.log').read_text()
    assert f'{sum(map(len, found.values()))} messages of 3 topics, ' in log


def test_a_burst_of_a_gyro_is_recorded_whole(nodes, probe, tmp_path):
    """As many rates as a publisher holds, faster than they are written."""
    nodes.start('bag_recorder', {'folder': str(tmp_path / 'bag'), 'topics': ['/imu']})
    publisher = probe.create_publisher(Imu, '/imu', qos.IMU)
    wait_recorded(probe, publisher)
    probe.send_until(lambda: publisher.publish(Imu()), lambda: messages(probe), 'the first one')
    before, burst = messages(probe), Imu()
    burst.header.frame_id = 'burst'
    for _ in range(qos.IMU.depth):
        publisher.publish(burst)
    probe.wait(lambda: messages(probe) >= before + qos.IMU.depth, 'all of the burst')
    assert nodes.stop(HANGS_S) == {'bag_recorder': 0}
    found, _ = recorded(tmp_path / 'bag')
    assert sum(message.header.frame_id == 'burst' for message in found['/imu']) == qos.IMU.depth


def test_a_killed_recorder_loses_what_is_not_on_the_disk_and_the_bag_is_recovered(
        probe, tmp_path):
    bag = tmp_path / 'bag'
    recorder = subprocess.Popen(
        [sys.executable, '-m', 'startracker_ros', 'record', 'numbers', '-o', str(bag)],
        stderr=subprocess.DEVNULL)
    try:
        publisher = probe.create_publisher(String, '/numbers', 100)
        wait_recorded(probe, publisher)
        send(publisher, map(str, range(200)))
        # They reach the disk by themselves, while none follow.
        probe.wait(lambda: len(list(read_messages(bag, tolerant=True))) == 200,
                   '200 messages on the disk')
        send(publisher, map(str, range(200, 300)))
    finally:
        recorder.send_signal(signal.SIGKILL)
        recorder.wait(HANGS_S)
    assert not (bag / 'metadata.yaml').exists()
    done = subprocess.run([sys.executable, '-m', 'startracker_ros', 'info', str(bag),
                           '--recover', str(tmp_path / 'whole')], capture_output=True, text=True,
                          timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(tmp_path / 'whole') as reader:
        texts = [store.deserialize_cdr(data, connection.msgtype).data
                 for connection, _, data in reader.messages()]
        assert reader.message_count == len(texts)
    assert texts == [str(number) for number in range(len(texts))]
    assert len(texts) >= 200
    with open(tmp_path / 'whole' / 'whole_0.mcap', 'rb') as file:
        assert make_reader(file).get_summary().statistics.message_count == len(texts)


FULL = """\
import resource
from startracker_ros.ros.node import main_of
from startracker_ros.ros.nodes.bag_recorder import BagRecorderNode

class FullDisk(BagRecorderNode):
    def rebuild(self):
        # Not earlier: the shared memory of DDS counts as files, too.
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))

main_of(FullDisk)()
"""


def test_a_full_disk_is_told_and_the_recorder_lives_on(probe, tmp_path):
    bag = tmp_path / 'bag'
    recorder = subprocess.Popen(
        [sys.executable, '-c', FULL, '--ros-args', '-p', f'folder:={bag}', '-p',
         'topics:=[/noise]', '-p', 'compression:=none'], env=dict(os.environ),
        stderr=subprocess.PIPE, text=True)
    try:
        publisher = probe.create_publisher(String, '/noise', 10)
        wait_recorded(probe, publisher)
        sent = 0
        while not any('File too large' in status.message for status in probe.statuses()):
            assert sent < 1000 and recorder.poll() is None
            publisher.publish(String(data=f'{sent:05d}' + 10_000 * 'x'))
            sent += 1
            probe.spin_for(0.05)
        status = probe.wait_diagnostic('the recording ends here')
        assert status.level == b'\x02'
    finally:
        recorder.send_signal(signal.SIGTERM)
        _, errors = recorder.communicate(timeout=HANGS_S)
    assert recorder.returncode == 0 and 'Traceback' not in errors, errors
    kept = [message.data[8:13].decode() for message in read_messages(bag, tolerant=True)]
    assert len(kept) >= 10 and kept == [f'{number:05d}' for number in range(len(kept))]


def test_ctrl_c_while_the_recorder_is_imported_leaves_a_bag(tmp_path):
    recorder = subprocess.Popen(
        [sys.executable, '-m', 'startracker_ros', 'record', '-o', str(tmp_path / 'bag')],
        stderr=subprocess.PIPE, text=True)
    command = Path('/proc', str(recorder.pid), 'cmdline')
    while b'bag_recorder' not in command.read_bytes():
        assert recorder.poll() is None
        time.sleep(0.005)
    recorder.send_signal(signal.SIGINT)
    _, errors = recorder.communicate(timeout=HANGS_S)
    assert recorder.returncode == 0 and 'Traceback' not in errors, errors
    assert '0 messages of 0 topics, 0 lost' in errors


def test_the_command_makes_a_bag_of_files(probe, tmp_path):
    recorder = subprocess.Popen(
        [sys.executable, '-m', 'startracker_ros', 'record', '/split', '-o', str(tmp_path / 'bag'),
         '--max-file-duration-s', '0.5', '--compression', 'lz4'],
        stderr=subprocess.PIPE, text=True)
    publisher = probe.create_publisher(String, '/split', 100)
    wait_recorded(probe, publisher)
    for number in range(30):
        publisher.publish(String(data=str(number)))
        time.sleep(0.05)
    probe.wait(lambda: messages(probe) == 30, 'all messages')
    recorder.send_signal(signal.SIGINT)
    _, errors = recorder.communicate(timeout=HANGS_S)
    assert recorder.returncode == 0 and '30 messages of 1 topics, 0 lost' in errors
    found, _ = recorded(tmp_path / 'bag')
    assert found['/split'] == [str(number) for number in range(30)]
    assert len(list(Path(tmp_path / 'bag').glob('*.mcap'))) >= 3
