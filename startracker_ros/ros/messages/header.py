# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Headers of messages."""

from builtin_interfaces.msg import Time
from std_msgs.msg import Header


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a message stamp of integer nanoseconds since the UNIX epoch."""
    return Time(sec=int(stamp_ns // 1_000_000_000), nanosec=int(stamp_ns % 1_000_000_000))


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """Return a header of integer nanoseconds and a frame."""
    return Header(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)
