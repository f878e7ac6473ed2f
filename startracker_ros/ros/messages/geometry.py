# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quaternions and vectors of geometry_msgs."""

from geometry_msgs.msg import Quaternion, Vector3
import numpy as np


def quaternion_to_geometry(quaternion: np.ndarray) -> Quaternion:
    """Return a quaternion (4,) in the order x, y, z, w."""
    x, y, z, w = map(float, quaternion)
    return Quaternion(x=x, y=y, z=z, w=w)


def vector_to_geometry(vector: np.ndarray) -> Vector3:
    """Return a vector (3,)."""
    x, y, z = map(float, vector)
    return Vector3(x=x, y=y, z=z)
