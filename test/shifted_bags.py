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


def write_shifted(bag: Path, folder: Path, shift_ns: int, change: Any = None) -> Path:
    """Write the inputs of a bag with earlier stamps, and messages as change() returns them."""
    with BagWriter(folder) as writer:
        for topic in map(read_topics(bag).__getitem__, INPUTS):
            writer.add_topic(topic.name, topic.type_name, topic.qos)
        for record in read_messages(bag, topics=INPUTS):
            message = _STORE.deserialize_cdr(record.data, record.type_name)
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(
                stamp.sec * 10 ** 9 + stamp.nanosec - shift_ns, 10 ** 9)
            if change is not None:
                message = change(message)
            data = bytes(_STORE.serialize_cdr(message, record.type_name))
            writer.write(record.topic, data, record.log_time_ns, record.publish_time_ns)
    return folder
