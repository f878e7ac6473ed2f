# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Frames of SER files, the format of planetary cameras (SER v3, Grafeneder and others).

A header of 178 bytes, the frames, and the time of each where the header has one. Times are in
100 ns from the year 1, UTC.
"""

from collections.abc import Iterator
from pathlib import Path
import struct
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import LARGEST_SIDE_PX
from startracker_ros.io.images.exif import Taken

BEGIN = b'LUCAM-RECORDER'
_HEADER = struct.Struct('<14s7i40s40s40s2q')
_RGB = 100, 101
_TICK_NS, _UNIX_TICKS = 100, 621_355_968_000_000_000
_SAMPLE = slice(None, None, 7)  # rows that show the order of the bytes


class SerHeader(NamedTuple):
    """Size in px, channels, bytes of a value, number of frames, UTC of the first in ticks."""

    width: int
    height: int
    channels: int
    value_bytes: int
    frames: int
    first_ticks: int

    @property
    def frame_bytes(self) -> int:
        """Return the bytes of a frame."""
        return self.width * self.height * self.channels * self.value_bytes


class SerFrame(NamedTuple):
    """Image (H, W) or (H, W, 3), uint8 or uint16, and its time, None if unknown."""

    image: np.ndarray
    taken: Taken | None


def read_header(content: bytes, most_pixels: int) -> SerHeader:
    """Return the header of a file by its first bytes; ValueError for none, or more pixels."""
    if len(content) < _HEADER.size or not content.startswith(BEGIN):
        raise ValueError('not a SER file')
    _, _, colour, _, width, height, bits, count, *_, first = _HEADER.unpack(
        content[:_HEADER.size])
    header = SerHeader(width, height, 3 if colour in _RGB else 1, 1 if bits <= 8 else 2, count,
                       first)
    if not (0 < width <= LARGEST_SIDE_PX and 0 < height <= LARGEST_SIDE_PX and 0 < bits <= 16
            and count > 0):
        raise ValueError(f'a SER file of {count} frames of {width} x {height} px of {bits} bits')
    if width * height > most_pixels:
        raise ValueError(f'frames of {width} x {height} px, at most '
                         f'{most_pixels // 1_000_000} million px are solved')
    return header


def ser_frames(path: Path, most_pixels: int) -> Iterator[SerFrame]:
    """Yield the whole frames of a file; ValueError for no such file or more pixels, OSError."""
    with path.open('rb') as file:
        header = read_header(file.read(_HEADER.size), most_pixels)
        # Of a truncated file the header still counts all, and the times are lost.
        whole = (path.stat().st_size - _HEADER.size) // header.frame_bytes
        ticks = np.empty(0, np.int64)
        if whole >= header.frames:
            file.seek(_HEADER.size + header.frames * header.frame_bytes)
            times = file.read(8 * header.frames)
            ticks = np.frombuffer(times[:len(times) // 8 * 8], '<i8')
            file.seek(_HEADER.size)
        for number in range(min(whole, header.frames)):
            block = file.read(header.frame_bytes)
            known = len(ticks) == header.frames and ticks[number] > _UNIX_TICKS
            at = int(ticks[number]) if known else header.first_ticks if number == 0 else 0
            yield SerFrame(_pixels(block, header), None if at <= _UNIX_TICKS else Taken(
                (at - _UNIX_TICKS) * _TICK_NS, True, 'SER'))


def _pixels(block: bytes, header: SerHeader) -> np.ndarray:
    shape = (header.height, header.width, 3)[:2 + (header.channels > 1)]
    if header.value_bytes == 1:
        return np.frombuffer(block, np.uint8).reshape(shape).copy()
    # Programs disagree on what the flag of the byte order means. In the wrong order neighbouring
    # pixels differ by much more.
    little, big = (np.frombuffer(block, order).reshape(shape).astype(np.uint16)
                   for order in ('<u2', '>u2'))
    return min(little, big, key=_roughness)


def _roughness(image: np.ndarray) -> float:
    sample = image[_SAMPLE].astype(np.int32)
    return float(np.abs(np.diff(sample, axis=1)).sum())
