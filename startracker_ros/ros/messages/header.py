# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Headers of messages, and the quaternions and vectors in them."""

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Vector3
import numpy as np
from std_msgs.msg import Header


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a message stamp of integer nanoseconds since the UNIX epoch."""
    return Time(sec=int(stamp_ns // 1_000_000_000), nanosec=int(stamp_ns % 1_000_000_000))


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """Return a header of integer nanoseconds and a frame."""
    return Header(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)


def quaternion_to_geometry(quaternion: np.ndarray) -> Quaternion:
    """Return a quaternion (4,) in the order x, y, z, w."""
    x, y, z, w = map(float, quaternion)
    return Quaternion(x=x, y=y, z=z, w=w)


def vector_to_geometry(vector: np.ndarray) -> Vector3:
    """Return a vector (3,)."""
    x, y, z = map(float, vector)
    return Vector3(x=x, y=y, z=z)
