# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings as other drivers publish them: stamps by another clock than UTC, Bayer mosaics."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_typestore, Stores
from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.bags.writer import BagWriter

INPUTS = ('/image_raw', '/camera_info', '/imu')
GPS_NS = 315_964_782 * 10 ** 9
"""UTC since 1970 less GPS time since 1980, from 2017 on."""

_EXPOSURE = 'sensor_msgs/msg/TimeReference'
_STORE = get_typestore(Stores.ROS2_JAZZY)


def mosaic(message: Any) -> Any:
    """Return an image or its camera_info as of a sensor with four equal pixels for each one."""
    if message.__msgtype__ == 'sensor_msgs/msg/Image':
        assert message.encoding == 'mono16'
        pixels = message.data.view('<u2').reshape(message.height, message.width)
        return replace(message, height=2 * message.height, width=2 * message.width,
                       encoding='bayer_grbg16', step=4 * message.width,
                       data=pixels.repeat(2, 0).repeat(2, 1).view(np.uint8).ravel())
    if message.__msgtype__ == 'sensor_msgs/msg/CameraInfo':
        k = 2 * message.k + np.array([0, 0, 0.5, 0, 0, 0.5, 0, 0, -1])
        p = np.column_stack([k.reshape(3, 3), np.zeros(3)]).ravel()
        return replace(message, height=2 * message.height, width=2 * message.width, k=k, p=p)
    return message


def exposure_start(header: Any, exposure_s: float) -> Any:
    """Return what a driver publishes before an image with this header."""
    stamp = header.stamp
    begin_ns = stamp.sec * 10 ** 9 + stamp.nanosec - round(exposure_s / 2 * 1e9)
    return _STORE.types[_EXPOSURE](
        header, type(stamp)(*divmod(begin_ns, 10 ** 9)), 'exposure')


def write_shifted(bag: Path, folder: Path, shift_ns: int, change: Any = None,
                  exposure_s: float = 0.0) -> Path:
    """
    Write the inputs of a bag with earlier stamps, and messages as change() returns them.

    With exposure_s an exposure_start precedes each image.
    """
    with BagWriter(folder) as writer:
        if exposure_s:
            writer.add_topic('/exposure_start', _EXPOSURE, ())
        for topic in map(read_topics(bag).__getitem__, INPUTS):
            writer.add_topic(topic.name, topic.type_name, topic.qos)
        for record in read_messages(bag, topics=INPUTS):
            message = _STORE.deserialize_cdr(record.data, record.type_name)
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(
                stamp.sec * 10 ** 9 + stamp.nanosec - shift_ns, 10 ** 9)
            if change is not None:
                message = change(message)
            if exposure_s and record.topic == '/image_raw':
                said = exposure_start(message.header, exposure_s)
                writer.write('/exposure_start', bytes(_STORE.serialize_cdr(said, _EXPOSURE)),
                             record.log_time_ns, record.publish_time_ns)
            data = bytes(_STORE.serialize_cdr(message, record.type_name))
            writer.write(record.topic, data, record.log_time_ns, record.publish_time_ns)
    return folder
