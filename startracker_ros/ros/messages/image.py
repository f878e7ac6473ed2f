# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of a camera: images, without a copy of the pixels where possible, and its geometry."""

import struct
import sys

from builtin_interfaces.msg import Time
import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.stages.annotate import RETICLE_TICKS_PX
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
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

    rclpy would copy the pixels three times. The bytes are little-endian CDR (OMG DDSI-RTPS 10.2).
    """
    try:
        sec, nanosec = struct.unpack_from('<iI', data, 4)
        frame_id, end = _cdr_string(data, 12)
        height, width = struct.unpack_from('<II', data, _aligned(end))
        encoding, end = _cdr_string(data, _aligned(end) + 8)
        big_endian = data[end]
        step, count = struct.unpack_from('<II', data, _aligned(end + 1))
    except (struct.error, IndexError) as error:
        raise MessageError(f'image message of {len(data)} bytes ends too early') from error
    begin = _aligned(end + 1) + 8
    if begin + count > len(data):
        raise MessageError(f'image message of {len(data)} bytes is too short for {count} of data')
    message = Image(header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id),
                    height=height, width=width, encoding=encoding, is_bigendian=big_endian,
                    step=step)
    set_image_data(message, memoryview(data)[begin:begin + count])
    return message


def _aligned(offset: int) -> int:
    """Return the offset of the next number of four bytes; the encapsulation has four itself."""
    return -(-offset // 4) * 4


def _cdr_string(data: bytes, offset: int) -> tuple[str, int]:
    """Return a zero-terminated string that follows its length, and the offset of its end."""
    begin = offset + 4
    end = begin + struct.unpack_from('<I', data, offset)[0]
    if end > len(data):
        raise IndexError(end)
    return data[begin:end].rstrip(b'\0').decode(errors='replace'), end


def camera_to_message(camera: Camera, header: Header) -> CameraInfo:
    """Return the CameraInfo of a camera."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    return CameraInfo(
        header=header, width=camera.width, height=camera.height,
        distortion_model=camera.distortion_model, d=list(camera.distortion), k=k,
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0])


def centroids_to_image_marker(uv: np.ndarray, header: Header) -> bytes:
    """Return `image_markers`, a reticle at each pixel uv (N, 2); each replaces the last one."""
    return cdr.image_lines(
        ns_from_stamp(header.stamp), header.frame_id, 'centroids',
        (uv[:, None] + RETICLE_TICKS_PX).reshape(-1, 2), width_px=1.5, colour=_COLOUR)
