# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A few frames of a bag as small pictures with their stars."""

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from startracker_ros.core.stages.annotate import stretch
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.layouts import image_from_message, MessageError, ns_from_stamp
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.io.recordings.recording import Recording

COUNT = 4
_LARGEST_PX = 768
# Noise hardly compresses: fewer grey levels make a much smaller file and look the same.
_GREY_STEP = 12


@dataclass(frozen=True)
class FramePicture:
    """An image as a PNG data URI; marks: what the pipeline saw of it, rows of a cloud."""

    stamp_ns: int
    width: int
    height: int
    data_uri: str
    marks: np.ndarray
    source: str


def frame_pictures(bag: Path, recording: Recording) -> tuple[list[FramePicture], str]:
    """Return pictures spread over the run, and why there are none if there are none."""
    images = recording.times['image_raw']
    topic = recording.full_name('image_raw')
    if not len(images):
        return [], f'The bag holds no images ({topic}).'
    solved = np.isin(images.stamp_ns, recording.attitude_ns)
    candidates = np.flatnonzero(solved) if solved.any() else np.arange(len(images))
    chosen = candidates[np.unique(np.linspace(0, len(candidates) - 1, COUNT).round().astype(int))]
    pictures: list[FramePicture] = []
    for index in chosen:
        try:
            image = read_frame(bag, recording, index)
        except (BagError, MessageError) as error:
            return pictures, f'The images of the bag ({topic}) cannot be drawn: {error}.'
        if image is not None:
            pictures.append(_picture(image, int(images.stamp_ns[index]), recording))
    return pictures, ''


def read_frame(bag: Path, recording: Recording, index: int) -> np.ndarray | None:
    """
    Return an image (H, W) by its place in the times of image_raw, None if it is not found.

    BagError where the bag is damaged, MessageError where the image is not one of grey pixels.
    """
    images = recording.times['image_raw']
    stamp_ns, received_ns = int(images.stamp_ns[index]), int(images.received_ns[index])
    for record in read_messages(bag, topics=(recording.full_name('image_raw'),),
                                start_ns=received_ns, tolerant=not recording.complete):
        message = record.decoded()
        if ns_from_stamp(message.header.stamp) == stamp_ns:
            return image_from_message(message).in_full()
    return None


def _picture(image: np.ndarray, stamp_ns: int, recording: Recording) -> FramePicture:
    height, width = image.shape
    scale = _LARGEST_PX / max(height, width)
    if scale < 1:
        image = cv2.resize(image, (max(1, round(width * scale)), max(1, round(height * scale))),
                           interpolation=cv2.INTER_AREA)
    # Stars are worth more than pixels in a small picture: smoothed, they stand out of the noise.
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    grey = stretch(image) // _GREY_STEP * _GREY_STEP
    png = cv2.imencode('.png', grey, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    marks, source = _marks(stamp_ns, recording)
    return FramePicture(stamp_ns, width, height,
                        'data:image/png;base64,' + base64.b64encode(png).decode(), marks, source)


def _marks(stamp_ns: int, recording: Recording) -> tuple[np.ndarray, str]:
    for source in ('tracks', 'stars', 'centroids'):
        clouds = getattr(recording, source)
        frame = np.flatnonzero(clouds.stamp_ns == stamp_ns)
        if len(frame):
            return clouds.of_frame(int(frame[0])), source
    return recording.centroids.rows[:0], ''
