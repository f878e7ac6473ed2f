# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Serialized messages of the types that come with every frame, read without rclpy.

rclpy makes an object of each field of a cloud and of each value of a status.
"""

from collections.abc import Callable
from copy import copy
from functools import cached_property, lru_cache
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from startracker_ros.io.bags import cdr
from startracker_ros.ros.messages.image import image_message_from_cdr
from std_msgs.msg import Header


def is_read_here(message_type: type) -> bool:
    """Return whether messages of a type are read here."""
    return message_type in _READERS


def deserialized(data: bytes, message_type: type) -> Any:
    """
    Return an object with the attributes of a message; MessageError if it is damaged.

    What is not read here is read by rclpy.
    """
    if message_type in _READERS and cdr.is_little_endian(data):
        return _READERS[message_type](data)
    return deserialize_message(data, message_type)


class PassedMessage:
    """
    A message within a process: the value that it says, without the way through bytes.

    It is serialized where DDS needs it, and read where a field other than the header is.
    """

    def __init__(self, message_type: Any, header: Header, value: Any,
                 serialize: Callable[[], bytes]) -> None:
        self._message_type, self._serialize = message_type, serialize
        self.header, self.value = header, value

    def __getattr__(self, name: str) -> Any:
        return getattr(self._read, name)

    @cached_property
    def serialized(self) -> bytes:
        """Return the bytes of the message."""
        return self._serialize()

    @cached_property
    def _read(self) -> Any:
        return deserialized(self.serialized, self._message_type)


def _camera_info(data: bytes) -> CameraInfo:
    """Return a message that is read once for all that differ in their stamp only."""
    message = copy(_stampless_camera_info(data[:4] + bytes(8) + data[12:]))
    message.header = Header(stamp=Time(**cdr.read_stamp(data)._asdict()),
                            frame_id=message.header.frame_id)
    return message


@lru_cache(maxsize=8)
def _stampless_camera_info(data: bytes) -> CameraInfo:
    return deserialize_message(data, CameraInfo)


_READERS: dict[type, Callable[[bytes], Any]] = {
    Image: image_message_from_cdr, CameraInfo: _camera_info,
    PointCloud2: cdr.read_point_cloud, Imu: cdr.read_imu, DiagnosticStatus: cdr.read_status}
