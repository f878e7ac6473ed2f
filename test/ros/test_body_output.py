# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Body attitude and transforms, with a stand-in for TFMessage: tf2_msgs has no wheel."""

from dataclasses import dataclass
import sys
from types import ModuleType

from geometry_msgs.msg import TransformStamped
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from startracker_ros.core.maths.rotation import quaternion_from_pointing
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
from startracker_ros.ros.body_output import BodyOutput, MountOptions
from startracker_ros.ros.frames import AttitudeFrameOptions
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.node import StartError

SENSOR, STAMP_NS = 'star_tracker_optical_frame', 1_790_000_000_123_456_789
# Neither symmetric nor of a positive w.
MOUNT = (-0.3618, 0.5012, 0.7391, -0.2671)
ATTITUDE = quaternion_from_pointing(1.2, -0.4, 2.5)


@dataclass
class StandInTFMessage:
    """The only field of tf2_msgs/TFMessage."""

    transforms: list[TransformStamped]


class RecordingNode:
    """The part of a PipelineNode that an output uses; publishers are lists of messages."""

    def __init__(self, mount: MountOptions, frames: AttitudeFrameOptions) -> None:
        self._options = {MountOptions: mount, AttitudeFrameOptions: frames}
        self.topics, self.profiles = {}, {}

    def options(self, cls):
        return self._options[cls]

    def advertise(self, message_type, topic, profile):
        messages = self.topics[topic] = []
        self.profiles[topic] = profile

        class Recorder:

            def publish(self, message):
                if isinstance(message, bytes):
                    message = deserialize_message(message, message_type)
                assert type(message) is message_type
                messages.append(message)
        return Recorder()


@pytest.fixture
def tf2_msgs(monkeypatch):
    """Install the stand-in."""
    module = ModuleType('tf2_msgs.msg')
    module.TFMessage = StandInTFMessage
    monkeypatch.setitem(sys.modules, 'tf2_msgs', ModuleType('tf2_msgs'))
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', module)


def published(sensor_frame_id='', followed=SENSOR, **options):
    node = RecordingNode(MountOptions(**options),
                         AttitudeFrameOptions(sensor_frame_id=sensor_frame_id))
    output = BodyOutput(node)
    output.rebuild()
    output.follow_frame(followed)
    output.publish(STAMP_NS, ATTITUDE)
    return node


def only(messages):
    message, = messages
    transform, = message.transforms
    t = transform.transform.translation
    assert (t.x, t.y, t.z) == (0, 0, 0)
    q = transform.transform.rotation
    return transform, Rotation.from_quat([q.x, q.y, q.z, q.w])


def is_same(one, other):
    return (one * other.inv()).magnitude() < 1e-12


def test_without_a_body_the_sensor_hangs_on_the_inertial_frame(tf2_msgs):
    node = published(publish_tf=True)
    transform, rotation = only(node.topics['/tf'])
    assert (transform.header.frame_id, transform.child_frame_id) == ('icrf', SENSOR)
    assert ns_from_stamp(transform.header.stamp) == STAMP_NS
    assert is_same(rotation, Rotation.from_quat(ATTITUDE))
    assert node.topics.keys() == {'/tf'}


def test_with_a_body_each_frame_has_one_parent_and_the_chain_is_the_attitude(tf2_msgs):
    node = published(publish_tf=True, body_frame_id='base_link', mount_quaternion=MOUNT)
    moving, icrf_from_body = only(node.topics['/tf'])
    static, body_from_sensor = only(node.topics['/tf_static'])
    assert (moving.header.frame_id, moving.child_frame_id) == ('icrf', 'base_link')
    assert (static.header.frame_id, static.child_frame_id) == ('base_link', SENSOR)
    assert is_same(body_from_sensor, Rotation.from_quat(MOUNT))
    assert is_same(icrf_from_body * body_from_sensor, Rotation.from_quat(ATTITUDE))
    assert node.profiles['/tf_static'].durability is DurabilityPolicy.TRANSIENT_LOCAL
    body, = node.topics['attitude_body']
    assert is_same(Rotation.from_quat(quaternion_from_message(body)), icrf_from_body)


def test_the_worked_example_of_the_conventions():
    node = RecordingNode(MountOptions(
        body_frame_id='base_link', mount_quaternion=(0.5, 0.5, 0.5, 0.5)), AttitudeFrameOptions())
    output = BodyOutput(node)
    output.rebuild()
    output.follow_frame(SENSOR)
    output.publish(STAMP_NS, quaternion_from_pointing(np.radians(84), 0.0, 0.0))
    body, = node.topics['attitude_body']
    assert body.header.frame_id == 'icrf'
    assert np.allclose(quaternion_from_message(body), [-0.743145, -0.669131, 0, 0], atol=1e-6)
    assert node.topics.keys() == {'attitude_body'}


@pytest.mark.parametrize('options, text', [
    ({'mount_quaternion': (0.0, 0.0, 0.0, 0.9), 'body_frame_id': 'base_link'}, 'norm 0.9000'),
    ({'mount_quaternion': MOUNT}, 'body_frame_id'),
    ({'body_frame_id': SENSOR, 'sensor_frame_id': SENSOR}, 'name of another frame'),
    ({'sensor_frame_id': 'icrf'}, 'name of another frame'),
    ({'body_frame_id': 'icrf'}, 'name of another frame'),
    ({'publish_tf': True}, 'ros-jazzy-tf2-msgs')])
def test_options_that_cannot_be_met_end_the_start_with_a_reason(options, text):
    with pytest.raises(StartError, match=text):
        published(**options)


def test_the_mount_has_the_frame_of_the_images_once_that_is_known_or_that_of_the_parameter(
        tf2_msgs):
    node = RecordingNode(
        MountOptions(publish_tf=True, body_frame_id='base_link'), AttitudeFrameOptions())
    output = BodyOutput(node)
    output.rebuild()
    assert not node.topics['/tf_static']
    for frame_id in ('cam', 'cam', 'other'):
        output.follow_frame(frame_id)
    assert [message.transforms[0].child_frame_id for message in node.topics['/tf_static']] == [
        'cam', 'other']
    for frame_id in ('base_link', 'icrf'):
        with pytest.raises(MessageError, match='name of another frame; set sensor_frame_id'):
            output.follow_frame(frame_id)
    node = published('lens', 'lens', publish_tf=True)
    assert only(node.topics['/tf'])[0].child_frame_id == 'lens'
