# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of the body that the sensor is mounted on, and both as transforms of tf2."""

from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import QuaternionStamped
import numpy as np
from startracker_ros.core.maths.rotation import conjugate, multiply
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import MessageError
from startracker_ros.ros import qos
from startracker_ros.ros.frames import AttitudeFrameOptions
from startracker_ros.ros.messages.attitude import quaternion_to_message, rotation_to_transform
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import PipelineNode, StartError

_NORM_TOLERANCE = 1e-3
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class MountOptions(Options):
    """The frames of sensor and body for tf2 and for users of the body attitude."""

    publish_tf: bool = option(
        False, 'broadcast the attitude on /tf: inertial_frame_id -> frame of the sensor or, with '
        'body_frame_id, inertial_frame_id -> body_frame_id and the mount on /tf_static; needs '
        'the package tf2_msgs', read_only=True)
    body_frame_id: str = option(
        '', 'frame of the body that the sensor is mounted on: publish its attitude '
        '(attitude_body); empty: none', read_only=True)
    mount_quaternion: tuple[float, ...] = option(
        _NO_ROTATION, 'rotation body from sensor in the order x, y, z, w: v_body = R(q) v_sensor',
        low=-1.0, high=1.0, read_only=True)


def _tf_message_type() -> Any:
    """Return tf2_msgs/TFMessage; StartError where it is not installed."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError as error:
        raise StartError(
            'publish_tf needs the package tf2_msgs, which is not installed: it comes with ROS 2 '
            '(apt install ros-jazzy-tf2-msgs), not with the wheels. attitude_transform has the '
            'same transform without it') from error
    return TFMessage


class BodyOutput:
    """
    Publishes attitude_body, /tf and /tf_static as MountOptions request.

    A frame of tf2 has one parent: with a body frame the sensor hangs on the body by the static
    transform, and the body on the inertial frame. StartError where the options contradict each
    other or tf2_msgs is missing.
    """

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        options: MountOptions = node.options(MountOptions)
        mount = np.array(options.mount_quaternion)
        norm = float(np.linalg.norm(mount))
        if abs(norm - 1) > _NORM_TOLERANCE:
            raise StartError(f'mount_quaternion = {list(options.mount_quaternion)} is of norm '
                             f'{norm:.4f}, a rotation has norm 1')
        if options.mount_quaternion != _NO_ROTATION and not options.body_frame_id:
            raise StartError('mount_quaternion needs the name of the body frame, body_frame_id')
        self._body_frame_id = options.body_frame_id
        self._q_body_from_sensor = mount / norm
        self._sensor_frame_id = ''
        self._attitude = self._tf = self._tf_static = None
        if self._body_frame_id:
            self._attitude = node.advertise(QuaternionStamped, 'attitude_body', qos.LIST)
        if options.publish_tf:
            self._tf_message = _tf_message_type()
            self._tf = node.advertise(self._tf_message, '/tf', qos.TF)
            if self._body_frame_id:
                self._tf_static = node.advertise(self._tf_message, '/tf_static', qos.STATE)

    def rebuild(self) -> None:
        """Use the frame of the sensor that is set; that of the images comes with the first one."""
        self._sensor_frame_id = ''
        sensor_frame_id = self._node.options(AttitudeFrameOptions).sensor_frame_id
        if twice := self._named_twice(sensor_frame_id):
            raise StartError(twice)
        if sensor_frame_id:
            self.follow_frame(sensor_frame_id)

    def follow_frame(self, sensor_frame_id: str) -> None:
        """Use a frame of the sensor: publish its mount; MessageError for the name of another."""
        if sensor_frame_id == self._sensor_frame_id:
            return
        if twice := self._named_twice(sensor_frame_id):
            raise MessageError(f'{twice}; set sensor_frame_id')
        self._sensor_frame_id = sensor_frame_id
        if self._tf_static is not None:
            # Valid at all times: tf2 does not read the stamp.
            self._tf_static.publish(self._tf_message(transforms=[rotation_to_transform(
                self._q_body_from_sensor, make_header(0, self._body_frame_id), sensor_frame_id)]))

    def _named_twice(self, sensor_frame_id: str) -> str:
        """Return which frame has the name of another one, in words; empty for none."""
        inertial_frame_id = self._node.options(AttitudeFrameOptions).inertial_frame_id
        if self._body_frame_id and self._body_frame_id in (sensor_frame_id, inertial_frame_id):
            return f'body_frame_id = {self._body_frame_id} is the name of another frame'
        if sensor_frame_id == inertial_frame_id:
            return f'inertial_frame_id = {inertial_frame_id} is the name of another frame'
        return ''

    def publish(self, stamp_ns: int, q_icrf_from_sensor: np.ndarray) -> None:
        """Publish an attitude (4,)."""
        header = make_header(
            stamp_ns, self._node.options(AttitudeFrameOptions).inertial_frame_id)
        quaternion, child = q_icrf_from_sensor, self._sensor_frame_id
        if self._attitude is not None:
            quaternion = multiply(q_icrf_from_sensor, conjugate(self._q_body_from_sensor))
            child = self._body_frame_id
            self._attitude.publish(quaternion_to_message(quaternion, header))
        if self._tf is not None:
            self._tf.publish(self._tf_message(
                transforms=[rotation_to_transform(quaternion, header, child)]))
