# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads bags, finished or not, and decodes messages, without rclpy."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory
import numpy as np
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.folder import find_files
from startracker_ros.io.bags.mcap_file import McapFile
from startracker_ros.io.bags.qos import qos_from_yaml, QosProfile
from startracker_ros.io.bags.remote import BagPath, RemotePath
from startracker_ros.io.bags.schemas import message_schema, MessageSchema
from startracker_ros.io.bags.sqlite_file import SQLITE_MAGIC, SqliteFile
from startracker_ros.io.bags.storage import (
    DECODING_ERRORS, first_unpacked_bytes, RawMessage, unpack, ZSTD_MAGIC)

_HEAD_BYTES = 2 ** 18

BagFile = McapFile | SqliteFile

# Messages of a span whose length gives the rate.
_GROUP = 10
_MAX_PROBLEMS = 100
"""Nobody reads more of them."""


def open_file(path: BagPath) -> BagFile:
    """Open a file of a bag; BagError if it cannot be read or is of no storage of rosbag2."""
    if isinstance(path, RemotePath):
        # SQLite reads files of this machine only.
        return McapFile(path)
    try:
        with path.open('rb') as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error
    if head.startswith(ZSTD_MAGIC):
        head = first_unpacked_bytes(head, len(SQLITE_MAGIC))
    return SqliteFile(path) if head.startswith(SQLITE_MAGIC) else McapFile(path)


class BagMessage(NamedTuple):
    """
    A message as recorded: serialized data, time of receipt (log) and of sending (publish).

    definition: the schema of its type in the bag, None where there is none.
    """

    topic: str
    type_name: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    definition: Schema | None = None

    def decoded(self) -> Any:
        """Return the message as decode() does, by the definition in the bag if need be."""
        return decode(self.type_name, self.data, self.definition)


@dataclass(frozen=True)
class BagTopic:
    """
    A topic of a bag and the number of its messages.

    encoding is that of the messages, cdr for ROS 2; schema is the definition in the bag, and
    qos what its publishers offered.
    """

    name: str
    type_name: str
    message_count: int
    encoding: str = field(default='cdr', compare=False)
    schema: MessageSchema = field(default=MessageSchema('', '', ''), compare=False)
    qos: tuple[QosProfile, ...] = field(default=(), compare=False)


def _ignore(problem: str) -> None:
    pass


def read_messages(bag: BagPath | str, *, topics: Sequence[str] = (), start_ns: int = 0,
                  end_ns: int = 2 ** 64, tolerant: bool = False,
                  report: Callable[[str], None] = _ignore) -> Iterator[BagMessage]:
    """
    Yield the messages of a bag folder or one of its files in the order of their log times.

    topics: only these, all if empty; start_ns: skip earlier log times; end_ns: and those from
    this one on.
    tolerant: read the intact messages of an unfinished or damaged file, in the order of writing
    if the index is lost, and report() each damage with its byte; otherwise UnfinishedBagError
    before the first message, or BagError at the damage.
    """
    files = find_files(bag, report if tolerant else None)
    for path in files.paths:
        with open_file(path) as file:
            in_order = file.is_sound
            for record in _records(file, topics, start_ns, tolerant, report):
                if record.log_time_ns >= end_ns and in_order:
                    break
                if not start_ns <= record.log_time_ns < end_ns or (
                        topics and record.channel.topic not in topics):
                    continue
                data = record.data
                if files.message_compression:
                    try:
                        data = unpack(data, files.message_compression)
                    except DECODING_ERRORS as error:
                        problem = f'{path}: a message of {record.channel.topic}: {error}'
                        if not tolerant:
                            raise BagError(problem) from error
                        report(problem)
                        continue
                yield BagMessage(record.channel.topic, _name(record.schema), data,
                                 record.log_time_ns, record.publish_time_ns, record.schema)


def read_topics(bag: BagPath | str, *, tolerant: bool = False,
                report: Callable[[str], None] = _ignore) -> dict[str, BagTopic]:
    """Return the topics of a bag by name; tolerant, report and errors as in read_messages()."""
    topics: dict[str, BagTopic] = {}
    for path in find_files(bag, report if tolerant else None).paths:
        with open_file(path) as file:
            for topic in _topics_of(file, tolerant, report):
                before = topics.get(topic.name)
                count = topic.message_count + (before.message_count if before else 0)
                topics[topic.name] = replace(topic, message_count=count)
    return topics


def decode(type_name: str, cdr: bytes, definition: Schema | None = None) -> Any:
    """
    Return a message with the fields of its type as attributes; BagError if that fails.

    The type is the installed one, and without ROS 2 that of a definition. Byte arrays are bytes,
    other arrays lists.
    """
    decoder = _installed_decoder(type_name)
    if decoder is None:
        if definition is None or not definition.data:
            raise BagError(f'{type_name} is not installed, and the bag does not define it')
        decoder = _decoder_of_bag(type_name, definition.encoding, definition.data)
    try:
        return decoder(cdr)
    except DECODING_ERRORS as error:
        raise BagError(f'{len(cdr)} bytes are not {type_name}: {error}') from error


@cache
def _installed_decoder(type_name: str) -> Callable[[bytes], Any] | None:
    """Return the decoder of an installed type, None where it is not installed."""
    schema = message_schema(type_name)
    return _decoder(type_name, schema.encoding, schema.text.encode())


@lru_cache(maxsize=64)
def _decoder_of_bag(type_name: str, encoding: str, text: bytes) -> Callable[[bytes], Any]:
    try:
        decoder = _decoder(type_name, encoding, text)
    # A definition of anybody may make the parser raise anything.
    except Exception as error:
        raise BagError(f'{type_name}: the definition in the bag is invalid: {error}') from error
    if decoder is None:
        raise BagError(f'{type_name}: a definition as {encoding!r} cannot be read')
    return decoder


def _decoder(type_name: str, encoding: str, text: bytes) -> Callable[[bytes], Any] | None:
    return DecoderFactory().decoder_for(
        'cdr', Schema(id=1, name=type_name, encoding=encoding, data=text))


def read_span_ns(bag: BagPath | str) -> tuple[int, int] | None:
    """Return the first and last log time of a bag, as far as it goes; None without messages."""
    spans = []
    for path in find_files(bag, _ignore).paths:
        with open_file(path) as file:
            if file.span_ns is not None:
                spans.append(file.span_ns)
    return (min(start for start, _ in spans), max(end for _, end in spans)) if spans else None


def read_rates_hz(bag: BagPath | str) -> dict[str, float]:
    """Return the messages a second of each topic where they are known; BagError as read_topics."""
    times: dict[str, list[np.ndarray]] = {}
    for path in find_files(bag, _ignore).paths:
        with open_file(path) as file:
            for number, log_times_ns in file.log_times().items():
                if channel := file.channels.get(number):
                    times.setdefault(channel.topic, []).append(log_times_ns)
    return {topic: rate for topic, pieces in times.items()
            if (rate := _rate_hz(np.sort(np.concatenate(pieces))))}


def _rate_hz(times_ns: np.ndarray) -> float | None:
    """
    Return the usual rate of messages at sorted times (N,), None where it is not known.

    Median over groups of some messages: neither a pause nor a late begin lowers it, and what
    arrives in bursts has its mean rate.
    """
    step = max(1, min(_GROUP, len(times_ns) // 8))
    spans_ns = times_ns[step:] - times_ns[:-step]
    median_ns = float(np.median(spans_ns)) if len(spans_ns) else 0.0
    return step * 1e9 / median_ns if median_ns else None


def read_blocks_ns(bag: BagPath | str) -> list[tuple[int, int]]:
    """Return the first and last log time of each chunk of a bag, as far as it goes."""
    spans: list[tuple[int, int]] = []
    for path in find_files(bag, _ignore).paths:
        with open_file(path) as file:
            spans += file.blocks_ns
    return spans


def _records(file: BagFile, topics: Sequence[str], start_ns: int, tolerant: bool,
             report: Callable[[str], None]) -> Iterator[RawMessage]:
    if not tolerant:
        return file.messages(topics, start_ns)
    if not file.is_sound:
        return file.intact_messages(report)
    return file.messages(topics, start_ns, report=report)


def _name(schema: Schema | None) -> str:
    return schema.name if schema else ''


def _topics_of(file: BagFile, tolerant: bool, report: Callable[[str], None]
               ) -> Iterator[BagTopic]:
    counts: dict[int, int] = {}
    if tolerant:
        for message in _records(file, (), 0, tolerant, report):
            counts[message.channel.id] = counts.get(message.channel.id, 0) + 1
    else:
        file.check()
        stated = file.message_counts
        if stated is None:
            for message in file.messages():
                counts[message.channel.id] = counts.get(message.channel.id, 0) + 1
        else:
            counts = stated
    for channel in file.channels.values():
        yield _topic(channel, file.schemas.get(channel.schema_id), counts.get(channel.id, 0))


def _topic(channel: Channel, schema: Schema | None, count: int) -> BagTopic:
    try:
        qos = qos_from_yaml(channel.metadata.get('offered_qos_profiles', ''))
    except ValueError:
        # Recorded by other software, perhaps; the messages are usable all the same.
        qos = ()
    definition = MessageSchema('', '', '') if schema is None else MessageSchema(
        schema.encoding, schema.data.decode(errors='replace'),
        channel.metadata.get('topic_type_hash', ''))
    return BagTopic(channel.topic, _name(schema), count, channel.message_encoding, definition, qos)


class TolerantBag:
    """
    Reads what is intact of a bag; report(problem) is called once for each kind of damage.

    topics and span_ns (the first and last log time, None of an empty bag) are read at once;
    BagError if nothing can be read.
    """

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        self._path = path
        self._report = report
        self._problems: set[str] = set()
        self.topics = self._read_topics()
        self.span_ns = read_span_ns(path)

    def messages(self, topics: Sequence[str], start_ns: int) -> Iterator[BagMessage]:
        """Yield the messages of topics from a log time on."""
        return read_messages(self._path, topics=tuple(topics), start_ns=start_ns, tolerant=True,
                             report=self._on_damage)

    def _read_topics(self) -> dict[str, BagTopic]:
        try:
            return read_topics(self._path)
        except BagError as error:
            topics = read_topics(self._path, tolerant=True)
            self._on_damage(str(error))
            return topics

    def _on_damage(self, problem: str) -> None:
        if problem not in self._problems and len(self._problems) < _MAX_PROBLEMS:
            self._problems.add(problem)
            self._report(problem)


# --- why a bag gives nothing: the one text of all commands that get no rows out of one ---

_LISTED = 10


def why_nothing(topics: Mapping[str, BagTopic], wanted: Mapping[str, str]) -> str:
    """Return why a bag holds none of the wanted messages, as missing() does, and what it holds."""
    return f'{missing(topics, wanted)}; {contents(topics)}'


def missing(topics: Mapping[str, BagTopic], wanted: Mapping[str, str]) -> str:
    """
    Return which of the wanted topics a bag does not have, or without messages of their type.

    wanted: types by full name or pattern of it, '' for any type.
    """
    reasons, absent = [], []
    for pattern, type_name in wanted.items():
        found = [topic for name, topic in sorted(topics.items()) if matches(name, (pattern,))]
        if not found:
            absent.append(pattern)
        for topic in found[:_LISTED]:
            if type_name not in ('', topic.type_name):
                reasons.append(f'{topic.name} is {topic.type_name or topic.encoding}, '
                               f'not {type_name}')
            elif not topic.message_count:
                reasons.append(f'{topic.name} has no messages')
    if absent:
        reasons.append(f'no {", ".join(absent)}')
    return '; '.join(reasons)


def contents(topics: Mapping[str, BagTopic]) -> str:
    """Return the number of messages of a bag, and their topics."""
    names = sorted(name for name, topic in topics.items() if topic.message_count)
    if not names:
        return 'the bag holds no messages'
    more = f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''
    return (f'the bag holds {sum(topic.message_count for topic in topics.values())} messages of '
            f'{", ".join(names[:_LISTED])}{more}')


# --- patterns of topic names ---

def matches(topic: str, patterns: Sequence[str]) -> bool:
    """
    Return whether a full topic name fits one of the patterns, * for any characters.

    The slash before a pattern may be left out.
    """
    return any(fnmatchcase(topic, pattern if pattern[:1] in '/*' else f'/{pattern}')
               for pattern in patterns)


def selected(topic: str, patterns: Sequence[str], exclude: Sequence[str]) -> bool:
    """Return whether a topic matches one of the patterns and none of those to exclude."""
    return matches(topic, patterns) and not matches(topic, exclude)
