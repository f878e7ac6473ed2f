# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of a camera: images, not copied where possible, their exposures, its geometry."""

import sys

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, TimeReference
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.stages.annotate import RETICLE_TICKS_PX
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.rclpy_internals import set_image_data
from std_msgs.msg import Header

_COLOUR = (1.0, 0.75, 0.25, 1.0)


def image_to_message(image: np.ndarray, header: Header) -> Image:
    """
    Return mono8, mono16 or rgb8 of (H, W) uint8 or uint16 or (H, W, 3) uint8.

    The message shows the image itself: a change of one is a change of the other.
    """
    image = np.ascontiguousarray(image)
    encoding = {(2, 1): 'mono8', (2, 2): 'mono16', (3, 1): 'rgb8'}[image.ndim, image.itemsize]
    message = Image(header=header, height=image.shape[0], width=image.shape[1],
                    encoding=encoding, is_bigendian=sys.byteorder == 'big',
                    step=image.strides[0])
    set_image_data(message, image.data.cast('B'))
    return message


def image_message_from_cdr(data: bytes) -> Image:
    """
    Return a message that shows the pixels of a serialized one; MessageError if it is damaged.

    rclpy would copy the pixels three times.
    """
    read = cdr.read_image(data)
    header = Header(stamp=Time(**read.header.stamp._asdict()), frame_id=read.header.frame_id)
    message = Image(header=header, height=read.height, width=read.width, encoding=read.encoding,
                    is_bigendian=read.is_bigendian, step=read.step)
    set_image_data(message, read.data)
    return message


def exposure_to_message(exposure_s: float, header: Header) -> TimeReference:
    """Return `exposure_start` of an image, whose stamp is the middle of its exposure."""
    begin_ns = ns_from_stamp(header.stamp) - round(exposure_s / 2 * 1e9)
    return TimeReference(header=header, time_ref=stamp_from_ns(begin_ns), source='exposure')


def camera_to_message(camera: Camera, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera."""
    return deserialize_message(
        cdr.camera_info(ns_from_stamp(header.stamp), header.frame_id, camera), CameraInfo)


def centroids_to_image_marker(uv: np.ndarray, header: Header) -> bytes:
    """Return `image_markers`, a reticle at each pixel uv (N, 2); each replaces the last one."""
    return cdr.image_lines(
        ns_from_stamp(header.stamp), header.frame_id, 'centroids',
        (uv[:, None] + RETICLE_TICKS_PX).reshape(-1, 2), width_px=1.5, colour=_COLOUR)
