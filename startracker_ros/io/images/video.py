# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of videos and of animated or paged image files."""

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import NamedTuple
import warnings

import cv2
import numpy as np
from PIL import Image
from startracker_ros.core.camera.levels import sixteen_bit
from startracker_ros.io.images.exif import Taken
from startracker_ros.io.images.images import grey, ImageError, MOST_PIXELS
from startracker_ros.io.images.ser_video import ser_frames

_SER = '.ser'
SUFFIXES = (_SER, '.avi', '.m4v', '.mkv', '.mov', '.mp4', '.mpeg', '.mpg', '.webm', '.wmv')
_PAGED = ('.apng', '.gif', '.png', '.tif', '.tiff', '.webp')
# OpenCV converts other pixel formats to 8-bit colour.
_GREY_16 = int.from_bytes(b'Y1\0\x10', 'little')


class Frame(NamedTuple):
    """
    Image (H, W) uint8 or uint16, its number in the file from 0, and its time in s from 0.

    The time is 0 for all where the file has none; taken is when a frame was taken where the file
    says that.
    """

    number: int
    time_s: float
    image: np.ndarray
    taken: Taken | None = None


def is_video(path: Path) -> bool:
    """Return whether a file is a video, or an image file with several frames."""
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return True
    if suffix not in _PAGED or not path.is_file():
        return False
    # The reader of single images names what is wrong with a file.
    try:
        with warnings.catch_warnings(action='ignore'), Image.open(path) as image:
            return getattr(image, 'n_frames', 1) > 1 and _page_sizes_agree(image)
    except Exception:  # noqa: B902 - Pillow raises errors of many types for damaged files.
        return False


def _page_sizes_agree(image: Image.Image) -> bool:
    """Return whether the second page is not a thumbnail of the first, as cameras write."""
    size = image.size
    image.seek(1)
    return image.size == size


def frames(path: Path) -> Iterator[Frame]:
    """
    Yield the frames of a file for which is_video() holds; colours are averaged to grey.

    ImageError for a file without a frame that can be decoded, or with too large ones.
    """
    suffix = path.suffix.lower()
    found = (_ser(path) if suffix == _SER else _video(path) if suffix in SUFFIXES
             else _pages(path))
    first = next(found, None)
    if first is None:
        raise ImageError(f'{path}: no frame that can be decoded')
    yield first
    yield from found


def _ser(path: Path) -> Iterator[Frame]:
    first: Taken | None = None
    try:
        for number, (image, taken) in enumerate(ser_frames(path, MOST_PIXELS)):
            first = taken if number == 0 else first
            time_s = 0.0 if first is None or taken is None else (
                taken.stamp_ns - first.stamp_ns) / 1e9
            yield Frame(number, time_s, grey(image), taken)
    except OSError as error:
        raise ImageError(f'{path}: {error.strerror}') from error
    except ValueError as error:
        raise ImageError(f'{path}: {error}') from error


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise ImageError(f'{path}: frames of {width} x {height} px, at most '
                         f'{MOST_PIXELS // 1_000_000} million px are solved')


def _video(path: Path) -> Iterator[Frame]:
    if not path.is_file():
        raise ImageError(f'{path}: no such file')
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            raise ImageError(f'{path}: not a video that OpenCV can read')
        _check_size(path, int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                    int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        if int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) == _GREY_16:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        for number in count():
            good, image = capture.read()
            if not good:
                return
            yield Frame(number, capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, grey(image))
    finally:
        capture.release()


def _pages(path: Path) -> Iterator[Frame]:
    time_s = 0.0
    with warnings.catch_warnings(action='ignore'), Image.open(path) as image:
        _check_size(path, *image.size)
        for number in range(getattr(image, 'n_frames', 1)):
            try:
                image.seek(number)
                pixels = _pixels(image)
            except (OSError, SyntaxError, ValueError) as error:
                if number:
                    return
                raise ImageError(f'{path}: {error}') from error
            yield Frame(number, time_s, grey(pixels))
            time_s += image.info.get('duration', 0) / 1e3


def _pixels(image: Image.Image) -> np.ndarray:
    """Return the current page as (H, W) or (H, W, 3) uint8, or (H, W) uint16."""
    if image.mode == 'I' and image.format == 'PNG':
        # Pillow before 10.3 has no mode of its own for 16 bit there.
        return np.asarray(image).astype(np.uint16)
    if image.mode in ('F', 'I'):
        return sixteen_bit(np.asarray(image))
    pixels = np.asarray(image if image.mode in ('L', 'I;16', 'I;16B') else image.convert('RGB'))
    return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder('='))
