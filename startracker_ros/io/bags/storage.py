# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What files of bags share: messages before their topic is looked at, and unpacking."""

from array import array
from collections.abc import Iterable
import os
import shutil
import struct
import tempfile
from typing import Any, BinaryIO, NamedTuple

import lz4.frame
from mcap.exceptions import McapError
from mcap.records import Channel, Schema
import numpy as np
from numpy.typing import ArrayLike
import zstandard


class RawMessage(NamedTuple):
    """A message as it stands in the file."""

    channel: Channel
    schema: Schema | None
    log_time_ns: int
    publish_time_ns: int
    data: bytes


def absolute(topic: str) -> str:
    """Return the full name of a topic; some recorders leave out the slash before it."""
    return topic if topic.startswith('/') else f'/{topic}'


def by_channel(times: Iterable[tuple[int, ArrayLike]]) -> dict[int, np.ndarray]:
    """Return log times (N,) by channel of pieces of them."""
    found: dict[int, array] = {}
    for number, piece in times:
        found.setdefault(number, array('Q')).frombytes(np.asarray(piece, np.uint64).tobytes())
    return {number: np.asarray(column) for number, column in found.items()}


# --- unpacking in bounded memory ---

MAX_RECORD_BYTES = 2 ** 28
"""Larger records, and chunks that unpack to more, are treated as damage, to bound the memory."""

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_PIECE_BYTES = 2 ** 20
_SHARE_OF_FREE_SPACE = 0.5

# lz4 raises RuntimeErrors.
DECODING_ERRORS = (McapError, zstandard.ZstdError, ValueError, KeyError, RuntimeError, MemoryError,
                   OverflowError, struct.error)
"""What the libraries raise on malformed bytes."""


def unpack(data: bytes | memoryview, compression: str, size: int | None = None) -> bytes:
    """
    Return data unpacked, of exactly size bytes if given; one of DECODING_ERRORS otherwise.

    At most MAX_RECORD_BYTES are unpacked, whatever size the data declare.
    """
    limit = MAX_RECORD_BYTES if size is None else size
    if limit > MAX_RECORD_BYTES:
        raise ValueError(f'{size} bytes unpacked')
    if compression == 'zstd':
        declared = zstandard.get_frame_parameters(data).content_size
        if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > limit:
            raise ValueError(f'{declared} bytes unpacked instead of {limit}')
        unpacked = zstandard.ZstdDecompressor().decompress(data, max_output_size=max(limit, 1))
    elif compression == 'lz4':
        unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit + 1)
    elif compression == '':
        unpacked = bytes(data)
    else:
        raise ValueError(f'compression {compression!r} is not known')
    if size is not None and len(unpacked) != size:
        raise ValueError(f'{len(unpacked)} bytes unpacked instead of {size}')
    return unpacked


def first_unpacked_bytes(packed: bytes, count: int) -> bytes:
    """Return the first bytes of the begin of a zstd file, fewer where it is damaged."""
    try:
        return zstandard.ZstdDecompressor().stream_reader(packed).read(count)
    except zstandard.ZstdError:
        return b''


def unpack_file(packed: BinaryIO) -> Any:
    """
    Return a named temporary file with a zstd file unpacked, as far as that goes, at its begin.

    ZstdError on malformed bytes, OSError if the disk fails, ValueError if half of its free space
    is not enough: a few bytes may declare any size.
    """
    folder = tempfile.gettempdir()
    limit = int(_SHARE_OF_FREE_SPACE * shutil.disk_usage(folder).free)
    unpacked = tempfile.NamedTemporaryFile(dir=folder)
    try:
        with zstandard.ZstdDecompressor().stream_reader(
                packed, read_across_frames=True, closefd=False) as stream:
            while piece := stream.read(_PIECE_BYTES):
                if unpacked.tell() + len(piece) > limit:
                    raise ValueError(f'more than {limit / 1e9:.1f} GB unpacked, half of the free '
                                     f'space of {folder}')
                unpacked.write(piece)
        unpacked.seek(0, os.SEEK_SET)
    except BaseException:
        unpacked.close()
        raise
    return unpacked
