# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compressed images: without loss, as image_transport has them; damage is named."""

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage
from startracker_ros.io.bags.layouts import MessageError
from startracker_ros.ros.messages.compressed_image import (
    image_from_compressed, image_to_compressed)
from startracker_ros.ros.messages.header import make_header

RNG = np.random.default_rng(3)
HEADER = make_header(1_790_000_000_123_456_789, 'lens')


def image_of(dtype, shape=(37, 53)):
    return RNG.integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def message_of(data, text='mono8; png compressed '):
    message = CompressedImage(header=HEADER, format=text)
    message.data.frombytes(bytes(data))
    return message


def png(image):
    return cv2.imencode('.png', image)[1].tobytes()


@pytest.mark.parametrize('dtype, text', [
    (np.uint8, 'mono8; png compressed '), (np.uint16, 'mono16; png compressed ')])
def test_pixels_come_back_as_they_were(dtype, text):
    for image in (image_of(dtype), image_of(dtype)[:, ::2], np.zeros((1, 1), dtype)):
        message = image_to_compressed(image, HEADER)
        assert message.header == HEADER and message.format == text
        back = image_from_compressed(message_of(message.data, text))
        assert back.dtype == dtype
        np.testing.assert_array_equal(back, image)


def test_every_cut_and_every_changed_byte_is_named():
    whole = png(image_of(np.uint8, (4, 5)))
    for length in range(len(whole)):
        with pytest.raises(MessageError, match='too early|not a PNG'):
            image_from_compressed(message_of(whole[:length]))
    for index in range(len(whole)):
        damaged = bytearray(whole)
        damaged[index] ^= 1 << index % 8
        with pytest.raises(MessageError, match='damaged|too early|not a PNG'):
            image_from_compressed(message_of(damaged))


@pytest.mark.parametrize('data, reason', [
    (b'', 'not a PNG'),
    (cv2.imencode('.jpg', image_of(np.uint8))[1].tobytes(), 'compressed.format of the camera'),
    (png(image_of(np.uint8, (8, 8, 3))), 'not grey'),
    (png(np.zeros((2 ** 13, 2 ** 13 + 1), np.uint8)), 'above 67108864 px')])
def test_what_is_not_a_grey_png_of_a_camera_is_named(data, reason):
    with pytest.raises(MessageError, match=reason):
        image_from_compressed(message_of(data))
