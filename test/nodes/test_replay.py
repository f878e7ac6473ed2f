# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A bag replayed into fresh nodes: every frame is answered, in the namespace of the nodes.

It is one of a camera that publishes best effort, as most do.
"""

from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import pytest
from queues import deep_queues
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, tracked_attitude_from_imu)
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.tools.figures.correctness import is_wrong

BAGS = Path(__file__).parents[2] / 'bags'
# As replay.launch.py starts the player, the stages and their manager.
INPUTS = ('image_raw', 'camera_info', 'imu', 'odometry')
# On a busy machine a subscriber may find a topic long after the player has found the subscriber.
PLAYER = {'topics': [f'*/{topic}' for topic in INPUTS], 'wait_for_camera_users': len(STAGES),
          'wait_limit_s': 300.0, 'start_delay_s': 2.0}
REMAPPINGS = [word for topic in INPUTS for word in ('-r', f'/{topic}:={topic}')]
SOME = (('slew', True), ('kidnapped', False))


def recorded(bag, topic):
    """Return the messages of a topic by their stamps."""
    messages = (deserialize_message(record.data, message_class(record.type_name))
                for record in read_messages(bag, topics=(topic,)))
    return {ns_from_stamp(message.header.stamp): message for message in messages}


def best_effort_inputs(bag, folder):
    """Return a copy of a bag whose inputs were offered as best effort."""
    with BagWriter(folder) as writer:
        for topic in read_topics(bag).values():
            if topic.name[1:] in INPUTS:
                writer.add_topic(topic.name, topic.type_name, [
                    replace(profile, reliability='best_effort') for profile in topic.qos])
        for message in read_messages(bag, topics=tuple(f'/{topic}' for topic in INPUTS)):
            writer.write(message.topic, message.data, message.log_time_ns,
                         message.publish_time_ns)
    return folder


def set_up_nodes(probe):
    """Return the nodes whose diagnostics name the camera that they are set up for."""
    return {status.name.partition(':')[0] for status in probe.statuses()
            if any(value.key == 'camera' for value in status.values)}


def stamps_ns(messages):
    return {ns_from_stamp(message.header.stamp) for message in messages}


def gaps(frames_ns, solved):
    """Return how many times frames without an attitude follow one with it, or the start."""
    has = [False, *(stamp_ns in solved for stamp_ns in sorted(frames_ns))]
    return 1 - has[1] + sum(one and not other for one, other in pairwise(has))


@pytest.mark.parametrize(('name', 'composed'), [
    pytest.param(name, composed, id=f'{name}-{"composed" if composed else "processes"}',
                 marks=() if (name, composed) in SOME else pytest.mark.long)
    for name, composed in product(('slew', 'kidnapped', 'dropouts'), (False, True))])
def test_every_frame_is_answered(nodes, probe, tmp_path, name, composed):
    bag, namespace = BAGS / name, 'trk'
    ready = []
    probe.create_subscription(PointCloud2, f'{namespace}/centroids', lambda message: ready or (
        ready.append(set_up_nodes(probe))), qos.LIST)
    probe.collect(Imu, f'{namespace}/attitude_imu', 100)
    # The player first: the nodes load their code while it waits.
    player = nodes.start('bag_player', {
        'path': str(best_effort_inputs(bag, tmp_path / 'bag')), **PLAYER}, REMAPPINGS,
        namespace=namespace)
    managed = {'autostart': False}
    depths = deep_queues(f'{namespace}/image_raw.subscription')
    for name in (('composed_pipeline',) if composed else STAGES):
        nodes.start(name, managed | depths, namespace=namespace)
    nodes.start('pipeline_manager', namespace=namespace)
    frames_ns = set(recorded(bag, '/image_raw'))
    answered = probe.received[f'{namespace}/attitude_imu']
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    probe.wait(lambda: stamps_ns(answered) == frames_ns, 'answers to all frames')
    assert ready[0] >= set(STAGES), 'a stage was not set up for the camera at the first frame'
    solved = {ns_from_stamp(message.header.stamp): tracked_attitude_from_imu(message).attitude
              for message in answered if message.orientation_covariance[0] >= 0}
    truth = recorded(bag, '/truth/attitude')
    assert not any(is_wrong(attitude.quaternion, attitude.covariance_sensor,
                            quaternion_from_message(truth[stamp_ns]))
                   for stamp_ns, attitude in solved.items())
    before = recorded(bag, '/attitude').keys()
    assert max(before) in solved
    if composed:
        # Images wait while the nodes are set up: on a busy machine more of them pass before the
        # first identification. Later no frame passes before that of an earlier one is done.
        assert gaps(frames_ns, solved) <= gaps(frames_ns, before)
        assert len([stamp_ns for stamp_ns in solved.keys() ^ before
                    if stamp_ns > min(solved)]) <= 10
