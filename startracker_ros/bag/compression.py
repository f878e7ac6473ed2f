"""Unpacks what bags hold compressed, in bounded memory."""

import struct

import lz4.frame
from mcap.exceptions import McapError
import zstandard

MAX_RECORD_BYTES = 2 ** 28
"""Larger records, and chunks that unpack to more, are treated as damage, to bound the memory."""

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
