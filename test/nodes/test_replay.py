"""A bag replayed into fresh nodes: every frame is answered, in the namespace of the nodes."""

from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.bag.reader import read_messages
from startracker_ros.executables import STAGES
from startracker_ros.ros.messages.message_types import message_class

BAGS = Path(__file__).parents[2] / 'bags'
# As replay.launch.py starts the player, the stages and their manager.
INPUTS = ('image_raw', 'camera_info', 'imu', 'odometry')
# On a busy machine a subscriber may find a topic long after the player has found the subscriber.
PLAYER = {'topics': [f'*/{topic}' for topic in INPUTS], 'wait_for_camera_users': len(STAGES),
          'wait_limit_s': 300.0, 'start_delay_s': 2.0}
REMAPPINGS = [word for topic in INPUTS for word in ('-r', f'/{topic}:={topic}')]


def recorded_ns(bag, topic):
    return {ns_from_stamp(deserialize_message(
        record.data, message_class(record.type_name)).header.stamp)
        for record in read_messages(bag) if record.topic == topic}


def stamps_ns(messages):
    return {ns_from_stamp(message.header.stamp) for message in messages}


@pytest.mark.parametrize('name', ['slew', 'kidnapped', 'dropouts'])
@pytest.mark.parametrize('composed', [False, True], ids=['processes', 'composed'])
def test_every_frame_is_answered(nodes, probe, name, composed):
    bag, namespace = BAGS / name, 'trk'
    probe.collect(Imu, f'{namespace}/attitude_imu', 100)
    # The player first: the nodes load their code while it waits.
    player = nodes.start('bag_player', {'path': str(bag), **PLAYER}, REMAPPINGS,
                         namespace=namespace)
    managed = {'autostart': False}
    depth = {f'qos_overrides./{namespace}/image_raw.subscription.depth': 10}
    if composed:
        nodes.start('composed_pipeline', managed | depth, namespace=namespace)
    else:
        for stage in STAGES:
            nodes.start(stage, managed | (depth if stage == 'centroid_extractor' else {}),
                        namespace=namespace)
    nodes.start('pipeline_manager', namespace=namespace)
    frames_ns = recorded_ns(bag, '/image_raw')
    probe.wait(lambda: player.poll() is not None, 'the end of the bag', timeout_s=600)
    answered = probe.received[f'{namespace}/attitude_imu']
    probe.spin_until(lambda: stamps_ns(answered) == frames_ns, 10)
    assert stamps_ns(answered) == frames_ns
    solved_ns = stamps_ns(m for m in answered if m.orientation_covariance[0] >= 0)
    # On a busy machine the first frames wait for their identification longer than in the bag.
    assert len(recorded_ns(bag, '/attitude') ^ solved_ns) <= 10
