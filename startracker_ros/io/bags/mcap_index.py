# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The summary of an MCAP file, read first where the head of each chunk would be a request."""

from dataclasses import dataclass, field
from io import BytesIO
import struct
from typing import Any
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from startracker_ros.io.bags.compression import DECODING_ERRORS, MAX_RECORD_BYTES

MAGIC = b'\x89MCAP0\r\n'
FRAME = struct.Struct('<BQ')
"""Before each record: opcode and length of the content."""

# Of the last record: start of the summary, start of its offsets, CRC of the summary up to here.
_FOOTER = struct.Struct('<QQL')
_CRC_BYTES = 4


@dataclass(frozen=True)
class Summary:
    """The end of a file from a byte on, and its chunks by their place; none that cannot be so."""

    start: int
    data: bytes = b''
    chunks: dict[int, ChunkIndex] = field(default_factory=dict)


def read_summary(file: Any, size: int) -> Summary:
    """Return the summary of a file, one without chunks where it has none or not a sound one."""
    nothing = Summary(size)
    footer_at = size - len(MAGIC) - _FOOTER.size - FRAME.size
    file.seek(max(footer_at, 0))
    footer = file.read(size)
    try:
        if FRAME.unpack_from(footer) != (Opcode.FOOTER, _FOOTER.size):
            return nothing
        start, _, crc = _FOOTER.unpack_from(footer, FRAME.size)
        if not 0 < start < footer_at or footer_at - start > MAX_RECORD_BYTES:
            return nothing
        file.seek(start)
        data = file.read(footer_at - start) + footer
        if crc and zlib.crc32(data[:-len(MAGIC) - _CRC_BYTES]) != crc:
            return nothing
        chunks, at = {}, 0
        while at < footer_at - start:
            opcode, length = FRAME.unpack_from(data, at)
            at += FRAME.size
            if opcode == Opcode.CHUNK_INDEX:
                index = ChunkIndex.read(ReadDataStream(BytesIO(data[at:at + length])))
                if index.chunk_length < FRAME.size:
                    return nothing
                chunks[index.chunk_start_offset] = index
            at += length
    except DECODING_ERRORS:
        return nothing
    return Summary(start, data, chunks)
