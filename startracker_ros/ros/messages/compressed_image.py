# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/CompressedImage as the transport `compressed` of image_transport has it, in PNG."""

import struct
import zlib

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage
from startracker_ros.io.bags.layouts import MessageError
from startracker_ros.ros.messages.rclpy_internals import set_image_data
from std_msgs.msg import Header

_SIGNATURE = b'\x89PNG\r\n\x1a\n'
# A small file can hold many equal pixels: 128 MiB at most.
_MOST_PIXELS = 2 ** 26
# Higher levels take several times as long for some per cent: star images are noise.
_LEVEL = 1
_GREY = 0
_FORMATS = {1: 'mono8; png compressed ', 2: 'mono16; png compressed '}
"""By bytes of a pixel, with the blank that compressed_image_transport ends them with."""


def image_to_compressed(image: np.ndarray, header: Header) -> CompressedImage:
    """Return the message of an image (H, W) uint8 or uint16, without loss."""
    data = cv2.imencode('.png', image, [cv2.IMWRITE_PNG_COMPRESSION, _LEVEL])[1]
    message = CompressedImage(header=header, format=_FORMATS[image.itemsize])
    set_image_data(message, data.data.cast('B'))
    return message


def image_from_compressed(message: CompressedImage) -> np.ndarray:
    """
    Return the image (H, W) uint8 or uint16 of a grey PNG; MessageError if it is not whole.

    JPEG is rejected: its loss moves centroids.
    """
    data = memoryview(message.data).cast('B')
    if data[:len(_SIGNATURE)] != _SIGNATURE:
        raise MessageError(f'compressed image of format {message.format!r} is not a PNG: set '
                           'image_raw.compressed.format of the camera to png')
    _check_chunks(data)
    width, height, depth, colour = struct.unpack_from('>IIBB', data, 16)
    if colour != _GREY or depth not in (8, 16):
        raise MessageError(f'compressed image of format {message.format!r} is not grey with 8 or '
                           '16 bits')
    if not 0 < width * height <= _MOST_PIXELS:
        raise MessageError(f'compressed image of {width} x {height} px is empty or above '
                           f'{_MOST_PIXELS} px')
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != (height, width):
        raise MessageError('compressed image is not a PNG that OpenCV can decode')
    return image


def _check_chunks(data: memoryview) -> None:
    """Raise MessageError unless all chunks are there with the right CRC (PNG, section 5)."""
    begin, kind = len(_SIGNATURE), b''
    while kind != b'IEND':
        if begin + 12 > len(data):
            raise MessageError(f'compressed image of {len(data)} bytes ends too early')
        length, = struct.unpack_from('>I', data, begin)
        end = begin + 8 + length
        if end + 4 > len(data):
            raise MessageError(f'compressed image of {len(data)} bytes ends too early')
        first, kind = not kind, bytes(data[begin + 4:begin + 8])
        if (first != (kind == b'IHDR') or first and length != 13
                or zlib.crc32(data[begin + 4:end]) != struct.unpack_from('>I', data, end)[0]):
            raise MessageError(f'compressed image is damaged at byte {begin}')
        begin = end + 4
