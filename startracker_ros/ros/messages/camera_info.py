# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/CameraInfo."""

from sensor_msgs.msg import CameraInfo
from startracker_ros.core.camera.model import Camera
from std_msgs.msg import Header


def camera_to_message(camera: Camera, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    return CameraInfo(
        header=header, width=camera.width, height=camera.height,
        distortion_model=camera.distortion_model, d=list(camera.distortion), k=k,
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0])
