# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A valid bag of any size whose images are holes of the file: some kilobytes on the disk."""

from dataclasses import replace
from pathlib import Path
import struct
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, Schema
from startracker_ros.io.bags.mcap_file import FRAME, MAGIC, McapFile, read_summary

_IMAGE = 60_000
"""Id of the channel and schema of the images, which a recording does not reach."""

# Of a chunk without CRC and compression: times, size, CRC, length of a name, size.
_CHUNK_HEAD = struct.Struct('<QQQLLQ')
_MESSAGE_HEAD = struct.Struct('<HLQQ')


def write_sparse_bag(source: Path, path: Path, size: int, image_bytes: int) -> int:
    """
    Write the chunks of an MCAP file and around them chunks of one image each; return their number.

    The images, on /camera/image_raw, are all zeros, and make the file as large as size.
    """
    images = -(-size // image_bytes)
    with McapFile(source) as file, open(source, 'rb') as stream, open(path, 'wb') as out:
        chunks = [*read_summary(stream, file.size).chunks.values()]
        out.write(MAGIC)
        indexes = []
        for number, chunk in enumerate(chunks):
            begin, end = (k * images // len(chunks) for k in (number, number + 1))
            for k in range(begin, end):
                if k == (begin + end) // 2:
                    indexes.append(_copied(stream, chunk, out))
                indexes.append(_add_image(out, chunk.message_start_time if k < (begin + end) // 2
                                          else chunk.message_end_time, image_bytes))
        summary = RecordBuilder()
        DataEnd(0).write(summary)
        start = out.tell() + summary.count
        for schema in (*file.schemas.values(),
                       Schema(id=_IMAGE, data=b'', encoding='', name='sensor_msgs/msg/Image')):
            schema.write(summary)
        for channel in (*file.channels.values(), Channel(
                id=_IMAGE, topic='/camera/image_raw', message_encoding='cdr', metadata={},
                schema_id=_IMAGE)):
            channel.write(summary)
        assert file.statistics is not None
        file.statistics.chunk_count = len(indexes)
        file.statistics.message_count += images
        file.statistics.channel_message_counts[_IMAGE] = images
        file.statistics.write(summary)
        for index in indexes:
            index.write(summary)
        Footer(summary_start=start, summary_offset_start=0, summary_crc=0).write(summary)
        out.write(summary.end() + MAGIC)
    return images


def _copied(stream: BinaryIO, chunk: ChunkIndex, out: BinaryIO) -> ChunkIndex:
    """Copy a chunk without its message indexes; return its index there."""
    at = out.tell()
    stream.seek(chunk.chunk_start_offset)
    out.write(stream.read(chunk.chunk_length))
    return replace(chunk, chunk_start_offset=at, message_index_length=0)


def _add_image(out: BinaryIO, log_time_ns: int, image_bytes: int) -> ChunkIndex:
    """Write the heads of a chunk and of its message, and leave out its zeros."""
    at = out.tell()
    size = FRAME.size + _MESSAGE_HEAD.size + image_bytes
    out.write(FRAME.pack(Opcode.CHUNK, _CHUNK_HEAD.size + size)
              + _CHUNK_HEAD.pack(log_time_ns, log_time_ns, size, 0, 0, size)
              + FRAME.pack(Opcode.MESSAGE, _MESSAGE_HEAD.size + image_bytes)
              + _MESSAGE_HEAD.pack(_IMAGE, 0, log_time_ns, log_time_ns))
    out.seek(image_bytes, 1)
    return ChunkIndex(
        chunk_length=out.tell() - at, chunk_start_offset=at, compression='',
        compressed_size=size, message_end_time=log_time_ns, message_index_length=0,
        message_index_offsets={_IMAGE: 0}, message_start_time=log_time_ns, uncompressed_size=size)
