# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
One MCAP file, complete or damaged, read in bounded memory (format: mcap.dev/spec).

The readers of the mcap library are not used: they stop at the first damage, load files without
chunks completely and unpack chunks of any size (docs/bags.md, `startracker bench bag`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
import heapq
from io import BytesIO
import struct
from types import TracebackType
from typing import Any
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics
import numpy as np
from startracker_ros.io.bags.errors import BagError, UnfinishedBagError
from startracker_ros.io.bags.remote import BagPath, RemotePath
from startracker_ros.io.bags.storage import (
    absolute, by_channel, DECODING_ERRORS, MAX_RECORD_BYTES, RawMessage, unpack, unpack_file,
    ZSTD_MAGIC)
import zstandard

# --- the summary, read first where the head of each chunk would be a request ---

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


# --- the file ---

_MAX_PENDING_BYTES = 2 ** 30
# Times of the first and last message, size and CRC unpacked, length of the compression's name.
_CHUNK = struct.Struct('<QQQLL')
# Channel, sequence number, log time, publish time.
_MESSAGE = struct.Struct('<HLQQ')
_ERRORS = (*DECODING_ERRORS, OSError)


@dataclass(frozen=True, slots=True)
class _Block:
    """A chunk, or a message outside of chunks: where it is in the file, and its log times."""

    offset: int
    length: int
    start_ns: int
    end_ns: int
    is_chunk: bool


@dataclass
class _Damage(Exception):
    """Bytes that cannot be right."""

    offset: int
    reason: str

    def __str__(self) -> str:
        return f'byte {self.offset}: {self.reason}'


class McapFile:
    """
    An open MCAP file, indexed by one pass over the heads of its records.

    schemas and channels by id; statistics is the file's own record, None if absent;
    compressions are those of its chunks. A file that rosbag2 has compressed as a whole (zstd) is
    unpacked into a temporary one; compressed_file says so.
    """

    def __init__(self, path: BagPath) -> None:
        """Open the file; BagError if it cannot be read or is not an MCAP file."""
        self.path = path
        try:
            self._file: Any = path.open('rb')
            magic = self._file.read(len(MAGIC))
            self.compressed_file = magic.startswith(ZSTD_MAGIC)
            if self.compressed_file:
                magic = self._unpack()
            self.size = self._file.seek(0, 2)
        except BagError:
            raise
        except OSError as error:
            raise BagError(f'cannot read {path}: {error.strerror}') from error
        if magic != MAGIC:
            self._file.close()
            raise BagError(f'{path} is not an MCAP file: it starts with {magic!r}')
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.statistics: Statistics | None = None
        self.compressions: set[str] = set()
        self._blocks: list[_Block] = []
        self._message_indexes: dict[int, dict[int, int]] = {}
        self._problems: list[_Damage] = []
        self._has_summary = False
        self._summary = Summary(self.size)
        self._unfinished: UnfinishedBagError | None = None
        try:
            self._scan()
        except BaseException:
            self._file.close()
            raise

    def _unpack(self) -> bytes:
        """Go on with the unpacked file; return its first bytes."""
        with self._file as packed:
            packed.seek(0)
            try:
                self._file = unpack_file(packed)
            except (zstandard.ZstdError, ValueError) as error:
                raise BagError(f'cannot unpack {self.path}: {error}') from error
        return self._file.read(len(MAGIC))

    def __enter__(self) -> 'McapFile':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._file.close()

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time by the heads of the chunks; None without messages."""
        spans = self.blocks_ns
        return (min(start for start, _ in spans), max(end for _, end in spans)) if spans else None

    @property
    def blocks_ns(self) -> list[tuple[int, int]]:
        """First and last log time of each chunk with messages, by their heads."""
        return [(b.start_ns, b.end_ns) for b in self._blocks if b.end_ns or not b.is_chunk]

    @property
    def message_counts(self) -> dict[int, int] | None:
        """Numbers of messages by channel as the file states them, None where it does not."""
        if self.statistics is None or not self._has_definitions:
            return None
        return self.statistics.channel_message_counts

    def log_times(self) -> dict[int, np.ndarray]:
        """
        Return the log times (N,) of the messages of each channel, in the order of the file.

        They are those of the indexes of chunks; where one is missing, every message is read.
        """
        if self.is_sound and self._has_definitions and all(
                block.offset in self._message_indexes or block.is_chunk and not block.end_ns
                for block in self._blocks):
            try:
                return by_channel((number, self._indexed_times(offset))
                                  for offsets in self._message_indexes.values()
                                  for number, offset in offsets.items())
            except (_Damage, ValueError):
                # Counted below instead.
                pass
        messages = self.messages if self.is_sound else self.intact_messages
        return by_channel((message.channel.id, [message.log_time_ns])
                          for message in messages(report=lambda problem: None))

    def _indexed_times(self, offset: int) -> np.ndarray:
        """Return the log times of a message index: channel, bytes, then times and offsets."""
        _, length = FRAME.unpack(self._read(offset, FRAME.size))
        return np.frombuffer(self._read(offset + FRAME.size, length), '<u8', offset=6)[::2]

    @property
    def _has_definitions(self) -> bool:
        """Whether the summary has the channels of all messages, and their schemas."""
        counted = () if self.statistics is None else self.statistics.channel_message_counts
        return self._has_summary and self.channels.keys() >= set(counted) and all(
            channel.schema_id in {0, *self.schemas} for channel in self.channels.values())

    @property
    def is_sound(self) -> bool:
        """Whether the file is complete and its index sound."""
        return self._unfinished is None and not self._problems

    def check(self) -> None:
        """Raise UnfinishedBagError or BagError unless the file is sound."""
        if not self.is_sound:
            raise self._unfinished or self._error(self._problems[0])

    def messages(self, topics: Sequence[str] = (), start_ns: int = 0, *,
                 report: Callable[[str], None] | None = None) -> Iterator[RawMessage]:
        """
        Yield messages in the order of their log times; errors as check(), or at the damage.

        With report, damaged chunks of a file with a sound index are reported and left out.
        """
        self.check()

        def fail(damage: _Damage) -> None:
            if report is None:
                raise self._error(damage) from damage
            report(f'{self.path}: {damage}')
        if not self._has_definitions:
            self._read_definitions(fail)
        wanted = {number for number, channel in self.channels.items()
                  if not topics or channel.topic in topics}
        yield from self._in_time_order(wanted, start_ns, bool(topics), fail)

    def intact_messages(self, report: Callable[[str], None]) -> Iterator[RawMessage]:
        """Yield intact messages in the order of the file; report() each damage."""
        for block in self._blocks:
            try:
                for _, content in self._message_records(block):
                    yield self._message(content, block.offset)
            except _Damage as damage:
                # A damaged chunk costs its own messages only.
                report(f'{self.path}: {damage}')
        for problem in self._problems:
            report(f'{self.path}: {problem}')
        if self._unfinished is not None:
            report(str(self._unfinished))

    def _error(self, damage: _Damage) -> BagError:
        return BagError(f'{self.path} is damaged at {damage}')

    # --- the records of the file ---

    def _scan(self) -> None:
        """Index chunks, messages, schemas and channels; check the end of the file."""
        if isinstance(self.path, RemotePath) and not self.compressed_file:
            self._summary = read_summary(self._file, self.size)
        at = len(MAGIC)
        in_summary = False
        while True:
            while index := self._summary.chunks.get(at):
                self._add_indexed(index)
                at += index.chunk_length + index.message_index_length
            frame = self._bytes(at, FRAME.size)
            opcode, length = FRAME.unpack(frame) if len(frame) == FRAME.size else (0, 0)
            end = at + FRAME.size + length
            if end > self.size or not opcode:
                self._add_end_problem(at, length)
                return
            try:
                if opcode == Opcode.DATA_END:
                    in_summary = True
                elif opcode == Opcode.FOOTER:
                    self._check_footer(at, length)
                    return
                else:
                    self._scan_record(opcode, at + FRAME.size, length, in_summary)
            except _ERRORS as error:
                self._problems.append(_Damage(at, _text(error)))
            except _Damage as damage:
                self._problems.append(damage)
            at = end

    def _add_indexed(self, index: ChunkIndex) -> None:
        """Add a chunk by what the summary says of it, without a look at its head."""
        self._blocks.append(_Block(
            index.chunk_start_offset + FRAME.size, index.chunk_length - FRAME.size,
            index.message_start_time, index.message_end_time, True))
        self.compressions.add(index.compression)

    def _add_end_problem(self, at: int, length: int) -> None:
        """Distinguish a file that was cut from one whose records are wrong."""
        if self._bytes(self.size - len(MAGIC), len(MAGIC)) == MAGIC and self.size > at + len(
                MAGIC):
            self._problems.append(_Damage(at, f'no record is {length} bytes long there'))
        else:
            self._unfinished = UnfinishedBagError(
                f'{self.path} was not finished: its index is missing, whole records end at byte '
                f'{at} of {self.size}')

    def _scan_record(self, opcode: int, offset: int, length: int, in_summary: bool) -> None:
        if opcode == Opcode.CHUNK and not in_summary:
            start_ns, end_ns, _, _, name_length = _CHUNK.unpack(self._bytes(offset, _CHUNK.size))
            self._blocks.append(_Block(offset, length, start_ns, end_ns, True))
            if name_length < 100:
                name = self._bytes(offset + _CHUNK.size, name_length)
                self.compressions.add(name.decode())
        elif opcode == Opcode.MESSAGE and not in_summary:
            if length < _MESSAGE.size:
                raise ValueError(f'a message of {length} bytes')
            log_time_ns = _MESSAGE.unpack(self._bytes(offset, _MESSAGE.size))[2]
            self._blocks.append(_Block(offset, length, log_time_ns, log_time_ns, False))
        elif opcode == Opcode.STATISTICS:
            self.statistics = Statistics.read(self._stream(offset, length))
        elif opcode == Opcode.CHUNK_INDEX:
            index = ChunkIndex.read(self._stream(offset, length))
            # Without entries it says that there is no index, not that the chunk is empty.
            if index.message_index_offsets:
                self._message_indexes[index.chunk_start_offset + FRAME.size] = (
                    index.message_index_offsets)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._has_summary |= in_summary and opcode == Opcode.CHANNEL
            self._define(opcode, self._read(offset, length))

    def _check_footer(self, at: int, length: int) -> None:
        footer = Footer.read(self._stream(at + FRAME.size, length))
        end = at + FRAME.size + length
        chunks = sum(block.is_chunk for block in self._blocks)
        if self.statistics is not None and self.statistics.chunk_count != chunks:
            self._problems.append(_Damage(
                at, f'the index counts {self.statistics.chunk_count} chunks, {chunks} are there'))
        if self._bytes(end, len(MAGIC) + 1) != MAGIC:
            self._add_end_problem(at, length)
        elif footer.summary_crc and footer.summary_start:
            # Of everything from the summary's start to the CRC itself.
            summary = self._read(footer.summary_start, end - 4 - footer.summary_start)
            if zlib.crc32(summary) != footer.summary_crc:
                self._problems.append(
                    _Damage(footer.summary_start, 'the CRC of the index differs'))

    def _define(self, opcode: int, content: bytes) -> None:
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        else:
            channel = Channel.read(stream)
            self.channels[channel.id] = replace(channel, topic=absolute(channel.topic))

    def _bytes(self, offset: int, length: int) -> bytes:
        if offset >= self._summary.start:
            return self._summary.data[offset - self._summary.start:][:length]
        self._file.seek(max(offset, 0))
        return self._file.read(length)

    def _read(self, offset: int, length: int) -> bytes:
        """Return exactly length bytes, at most MAX_RECORD_BYTES; _Damage otherwise."""
        if not 0 <= length <= MAX_RECORD_BYTES:
            raise _Damage(offset, f'a record of {length} bytes')
        try:
            data = self._bytes(offset, length)
        except (OSError, OverflowError) as error:
            raise _Damage(offset, _text(error)) from error
        if len(data) != length:
            raise _Damage(offset, f'{length} bytes are not there')
        return data

    def _stream(self, offset: int, length: int) -> ReadDataStream:
        return ReadDataStream(BytesIO(self._read(offset, length)))

    # --- messages ---

    def _read_definitions(self, fail: Callable[[_Damage], None]) -> None:
        """Read schemas and channels from the chunks, for a file without a summary."""
        for block in self._blocks:
            if block.is_chunk:
                try:
                    for _ in self._chunk_records(block):
                        pass
                except _Damage as damage:
                    fail(damage)

    def _in_time_order(self, wanted: set[int], start_ns: int, chosen: bool,
                       fail: Callable[[_Damage], None]) -> Iterator[RawMessage]:
        # Equal log times stay in the order of the file.
        heap: list[tuple[int, int, int, RawMessage]] = []
        pending_bytes = 0
        for block in sorted(self._blocks, key=lambda block: (block.start_ns, block.offset)):
            while heap and heap[0][0] < block.start_ns:
                message = heapq.heappop(heap)[3]
                pending_bytes -= len(message.data)
                yield message
            channels = self._message_indexes.get(block.offset, wanted)
            if block.end_ns < start_ns or (chosen and wanted.isdisjoint(channels)):
                continue
            try:
                for order, message in self._in_block(block):
                    if message.channel.id in wanted and message.log_time_ns >= start_ns:
                        pending_bytes += len(message.data)
                        heapq.heappush(heap, (message.log_time_ns, block.offset, order, message))
            except _Damage as damage:
                fail(damage)
            if pending_bytes > _MAX_PENDING_BYTES:
                fail(_Damage(block.offset, f'{pending_bytes} bytes of chunks overlap in time'))
                while heap:
                    yield heapq.heappop(heap)[3]
                pending_bytes = 0
        while heap:
            yield heapq.heappop(heap)[3]

    def _in_block(self, block: _Block) -> Iterator[tuple[int, RawMessage]]:
        """Yield the messages of a block with their offset in it."""
        for order, content in self._message_records(block):
            message = self._message(content, block.offset)
            if not block.start_ns <= message.log_time_ns <= block.end_ns:
                raise _Damage(block.offset, f'a message of {message.log_time_ns} ns in a chunk '
                                            f'from {block.start_ns} to {block.end_ns} ns')
            yield order, message

    def _message_records(self, block: _Block) -> Iterator[tuple[int, bytes]]:
        """Yield the message records of a block with their offset in it."""
        if block.is_chunk:
            yield from self._chunk_records(block)
        else:
            yield 0, self._read(block.offset, block.length)

    def _message(self, content: bytes, offset: int) -> RawMessage:
        number, _, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(content)
        channel = self.channels.get(number)
        if channel is None:
            raise _Damage(offset, f'a message of an unknown channel, {number}')
        return RawMessage(channel, self.schemas.get(channel.schema_id), log_time_ns,
                          publish_time_ns, content[_MESSAGE.size:])

    def _chunk_records(self, block: _Block) -> Iterator[tuple[int, bytes]]:
        """Yield the message records of a chunk; store its schemas and channels."""
        data = memoryview(self._unpacked(block))
        at = 0
        while at < len(data):
            try:
                opcode, length = FRAME.unpack_from(data, at)
                start, end = at + FRAME.size, at + FRAME.size + length
                if end > len(data):
                    raise ValueError(f'a record of {length} bytes')
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._define(opcode, bytes(data[start:end]))
                elif opcode == Opcode.MESSAGE:
                    if length < _MESSAGE.size:
                        raise ValueError(f'a message of {length} bytes')
                    yield at, bytes(data[start:end])
            except _ERRORS as error:
                raise _Damage(block.offset, f'{_text(error)} at {at} in the chunk') from error
            at = end

    def _unpacked(self, block: _Block) -> bytes:
        content = self._read(block.offset, block.length)
        try:
            _, _, size, crc, name_length = _CHUNK.unpack_from(content)
            name_end = _CHUNK.size + name_length
            compression = content[_CHUNK.size:name_end].decode()
            length, = struct.unpack_from('<Q', content, name_end)
            packed = memoryview(content)[name_end + 8:]
            if len(packed) != length:
                raise ValueError(f'a chunk of {length} bytes in {len(packed)}')
            data = unpack(packed, compression, size)
            if crc and zlib.crc32(data) != crc:
                raise ValueError('the CRC of the chunk differs')
            return data
        except _ERRORS as error:
            raise _Damage(block.offset, _text(error)) from error


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
