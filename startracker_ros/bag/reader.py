"""Reads bags, finished or not, and decodes messages, without rclpy."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
import struct
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from startracker_ros.bag.errors import BagError, UnfinishedBagError
from startracker_ros.bag.schemas import message_schema

_MAGIC = b'\x89MCAP0\r\n'
# Opcode and length of the content stand before each record.
_FRAME = struct.Struct('<BQ')
# What the libraries raise on bytes that are not what they should be; CRC errors are
# ValueErrors, lz4 raises RuntimeErrors, absurd lengths end in MemoryErrors.
_DAMAGE = (McapError, ZstdError, ValueError, KeyError, RuntimeError, MemoryError, OverflowError,
           OSError, struct.error)


@dataclass(frozen=True)
class BagMessage:
    """A message as it came in: serialized data, when it was received and when it was sent."""

    topic: str
    type_name: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag and the number of its messages."""

    name: str
    type_name: str
    message_count: int


def read_messages(bag: Path, *, topics: Sequence[str] = (), start_ns: int = 0,
                  tolerant: bool = False) -> Iterator[BagMessage]:
    """Yield the messages of a bag folder or an MCAP file in the order of their log times.

    topics: those wanted, all if empty; start_ns: the first log time wanted.
    tolerant: read what is whole of an unfinished or damaged file, in the order of writing;
    otherwise UnfinishedBagError before the first message, or BagError where the damage is.
    """
    for path in _mcap_files(Path(bag)):
        for schema, channel, message in _scan(path, tolerant, topics, start_ns):
            yield BagMessage(channel.topic, _name(schema), message.data, message.log_time,
                             message.publish_time)


def read_topics(bag: Path, *, tolerant: bool = False) -> dict[str, BagTopic]:
    """Return the topics of a bag by name; tolerant and errors as in read_messages()."""
    topics: dict[str, BagTopic] = {}
    for path in _mcap_files(Path(bag)):
        for topic in (_counted_topics(path) if tolerant else _indexed_topics(path)):
            before = topics.get(topic.name)
            count = topic.message_count + (before.message_count if before else 0)
            topics[topic.name] = replace(topic, message_count=count)
    return topics


def decode(type_name: str, cdr: bytes) -> Any:
    """Return a message with the fields of its type as attributes; BagError if that fails.

    The type is the installed one. Byte arrays are bytes, other arrays lists.
    """
    decoder = _decoder(type_name)
    try:
        return decoder(cdr)
    except _DAMAGE as error:
        raise BagError(f'{len(cdr)} bytes are no {type_name}: {error}') from error


@lru_cache(maxsize=None)
def _decoder(type_name: str) -> Callable[[bytes], Any]:
    schema = message_schema(type_name)
    decoder = DecoderFactory().decoder_for(
        'cdr', Schema(id=1, name=type_name, encoding=schema.encoding, data=schema.text.encode()))
    if decoder is None:
        raise BagError(f'{type_name} is not installed')
    return decoder


def _name(schema: Schema | None) -> str:
    return schema.name if schema else ''


def _mcap_files(bag: Path) -> list[Path]:
    if not bag.is_dir():
        return [bag]
    files = sorted(bag.glob('*.mcap'), key=lambda path: (len(path.name), path.name))
    if not files:
        raise BagError(f'{bag} holds no .mcap file')
    return files


def _scan(path: Path, tolerant: bool, topics: Sequence[str],
          start_ns: int) -> Iterator[tuple[Schema | None, Channel, Message]]:
    if not tolerant:
        yield from _indexed_messages(path, topics, start_ns)
        return
    for schema, channel, message in _whole_messages(path):
        if message.log_time >= start_ns and (not topics or channel.topic in topics):
            yield schema, channel, message


def _open(path: Path) -> BinaryIO:
    try:
        file = open(path, 'rb')
        magic = file.read(len(_MAGIC))
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error
    if magic != _MAGIC:
        file.close()
        raise BagError(f'{path} is no MCAP file: it starts with {magic!r}')
    return file


def _open_finished(path: Path) -> BinaryIO:
    file = _open(path)
    size = file.seek(-len(_MAGIC), 2) + len(_MAGIC)
    if size < 2 * len(_MAGIC) or file.read() != _MAGIC:
        whole = max((start + length for _, start, length in _whole_records(file)),
                    default=len(_MAGIC))
        file.close()
        raise UnfinishedBagError(
            f'{path} was not finished: its index is missing, whole records end at byte {whole} '
            f'of {size}')
    file.seek(0)
    return file


def _indexed_messages(path: Path, topics: Sequence[str],
                      start_ns: int) -> Iterator[tuple[Schema | None, Channel, Message]]:
    with _open_finished(path) as file:
        try:
            yield from make_reader(file, validate_crcs=True).iter_messages(
                topics or None, starting_at=start_ns)
        except _DAMAGE as error:
            raise _damaged(path, file, error) from error


def _indexed_topics(path: Path) -> list[BagTopic]:
    with _open_finished(path) as file:
        try:
            summary = make_reader(file).get_summary()
        except _DAMAGE as error:
            raise _damaged(path, file, error) from error
    if summary is None or summary.statistics is None:
        return _counted_topics(path)
    counts = summary.statistics.channel_message_counts
    return [BagTopic(channel.topic, _name(summary.schemas.get(channel.schema_id)),
                     counts.get(channel.id, 0)) for channel in summary.channels.values()]


def _damaged(path: Path, file: BinaryIO, error: Exception) -> BagError:
    reason = str(error) or type(error).__name__
    return BagError(f'{path} is damaged before byte {file.tell()}: {reason}')


def _counted_topics(path: Path) -> list[BagTopic]:
    topics: dict[str, BagTopic] = {}
    for schema, channel, _ in _whole_messages(path):
        topic = topics.get(channel.topic) or BagTopic(channel.topic, _name(schema), 0)
        topics[channel.topic] = replace(topic, message_count=topic.message_count + 1)
    return list(topics.values())


def _whole_messages(path: Path) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield every message that is whole, in the order of the file, without its index."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with _open(path) as file:
        for opcode, start, length in _whole_records(file):
            file.seek(start)
            try:
                records = _contents(opcode, file.read(length))
            except _DAMAGE:
                # A damaged chunk costs its own messages only.
                continue
            for record in records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message) and record.channel_id in channels:
                    channel = channels[record.channel_id]
                    yield schemas.get(channel.schema_id), channel, record


def _whole_records(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and length of each record of the data that is there in full."""
    size = file.seek(0, 2)
    end = len(_MAGIC)
    while end + _FRAME.size <= size:
        file.seek(end)
        opcode, length = _FRAME.unpack(file.read(_FRAME.size))
        start, end = end + _FRAME.size, end + _FRAME.size + length
        if end > size or opcode == Opcode.DATA_END:
            return
        yield opcode, start, length


def _contents(opcode: int, data: bytes) -> list[McapRecord]:
    """Return what a record of the data section says of schemas, channels and messages."""
    stream = ReadDataStream(BytesIO(data))
    match opcode:
        case Opcode.CHUNK:
            return breakup_chunk(Chunk.read(stream), validate_crc=True)
        case Opcode.SCHEMA:
            return [Schema.read(stream)]
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.MESSAGE:
            return [Message.read(stream, len(data))]
    return []
