# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings of drivers that stamp by another clock than UTC."""

from pathlib import Path
import struct

from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.bags.writer import BagWriter

INPUTS = ('/image_raw', '/camera_info', '/imu')
GPS_NS = 315_964_782 * 10 ** 9
"""UTC since 1970 less GPS time since 1980, from 2017 on."""


def write_shifted(bag: Path, folder: Path, shift_ns: int) -> Path:
    """Write the inputs of a bag with stamps, of which each message begins with one, shifted."""
    with BagWriter(folder) as writer:
        for topic in map(read_topics(bag).__getitem__, INPUTS):
            writer.add_topic(topic.name, topic.type_name, topic.qos)
        for message in read_messages(bag, topics=INPUTS):
            data = bytearray(message.data)
            sec, nanosec = struct.unpack_from('<iI', data, 4)
            stamp_ns = sec * 10 ** 9 + nanosec - shift_ns
            struct.pack_into('<iI', data, 4, *divmod(stamp_ns, 10 ** 9))
            writer.write(
                message.topic, bytes(data), message.log_time_ns, message.publish_time_ns)
    return folder
