# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a bag as rosbag2 (Jazzy, storage mcap) writes it, so that its tools read and play it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer
from startracker_ros.core.ctrl_c import interrupted_by_ctrl_c
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.schemas import message_schema, MessageSchema
import yaml

# --- metadata.yaml of a bag, version 9 (rosbag2 of Jazzy) ---

# The start of a bag without messages, as rosbag2 writes it.
_NEVER_NS = 2 ** 63 - 1


@dataclass
class TopicRecord:
    """One topic of a bag, and how many messages it has so far."""

    name: str
    type_name: str
    type_hash: str
    qos: tuple[QosProfile, ...]
    encoding: str = 'cdr'
    message_count: int = 0


@dataclass
class FileRecord:
    """One file of a bag: how many messages it has so far, and their first and last log time."""

    name: str
    message_count: int = 0
    span_ns: tuple[int, int] | None = None

    def count(self, log_time_ns: int) -> None:
        """Add a message."""
        start_ns, end_ns = self.span_ns or (log_time_ns, log_time_ns)
        self.span_ns = min(start_ns, log_time_ns), max(end_ns, log_time_ns)
        self.message_count += 1


def bag_information(files: Sequence[FileRecord], topics: Sequence[TopicRecord]) -> dict[str, Any]:
    """Return the metadata of a bag of these files."""
    spans = [file.span_ns for file in files if file.span_ns]
    span_ns = (min(start for start, _ in spans), max(end for _, end in spans)) if spans else None
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **_duration(span_ns),
        **_start(span_ns),
        'message_count': sum(file.message_count for file in files),
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name,
                'type': topic.type_name,
                'serialization_format': topic.encoding,
                'offered_qos_profiles': [profile.as_dict() for profile in topic.qos],
                'type_description_hash': topic.type_hash,
            },
            'message_count': topic.message_count,
        } for topic in topics],
        # Of complete files or single messages; chunks are compressed by MCAP.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [{
            'path': file.name,
            **_start(file.span_ns),
            **_duration(file.span_ns),
            'message_count': file.message_count,
        } for file in files],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def _start(span_ns: tuple[int, int] | None) -> dict[str, Any]:
    start_ns = span_ns[0] if span_ns else _NEVER_NS
    return {'starting_time': {'nanoseconds_since_epoch': start_ns}}


def _duration(span_ns: tuple[int, int] | None) -> dict[str, Any]:
    duration_ns = span_ns[1] - span_ns[0] if span_ns else 0
    return {'duration': {'nanoseconds': duration_ns}}


def to_yaml(value: Any) -> str:
    """Return YAML in the layout of rosbag2, without the last newline."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, default_flow_style=False,
                     width=2 ** 16).rstrip('\n')


class _Dumper(yaml.SafeDumper):
    """Lists indented below their key, ~ for nothing, "" for an empty string."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    type(None), lambda dumper, value: dumper.represent_scalar('tag:yaml.org,2002:null', '~'))
_Dumper.add_representer(
    str, lambda dumper, value: dumper.represent_scalar(
        'tag:yaml.org,2002:str', value, style=None if value else '"'))


# --- the bag ---

# Most log time that is lost when the process is killed.
_FLUSH_NS = 10 ** 9


@dataclass(frozen=True)
class BagOptions(Options):
    """How a bag is laid out on disk."""

    compression: str = option(
        'zstd', 'of the chunks: zstd halves what lz4 leaves of noisy images in nearly twice the '
        'time', choices=('none', 'lz4', 'zstd'), read_only=True)
    chunk_size_bytes: int = option(
        2 ** 20, 'a chunk is closed when it is larger', unit='byte', low=2 ** 12, high=2 ** 30,
        read_only=True)
    max_file_size_mb: float = option(
        0.0, 'a new file of the bag begins when one is larger; 0 for one file', unit='MB', low=0.0,
        high=1e6, read_only=True)
    max_file_duration_s: float = option(
        0.0, 'a new file of the bag begins when one spans more; 0 for one file', unit='s', low=0.0,
        high=1e6, read_only=True)


class BagWriter:
    """
    A bag being written: a folder of MCAP files, and metadata.yaml once it is closed.

    Messages reach the operating system within 1 s of log time: they survive the end of the
    process, not a power cut. After a BagError from write() or flush() the bag is closed and
    the earlier messages are readable.
    """

    def __init__(self, folder: Path, *, options: BagOptions = BagOptions(),
                 flush_ns: int = _FLUSH_NS) -> None:
        """
        Create the folder; BagError if it is not empty or cannot be written.

        flush_ns is the log time after which a chunk is closed, 0 for never before it is full:
        for bags that are computed, whose messages are not lost with the process.
        """
        self._folder = Path(folder)
        self._options = options
        self._flush_ns = flush_ns
        self._topics: dict[str, TopicRecord] = {}
        self._schemas: dict[str, MessageSchema] = {}
        self._files: list[FileRecord] = []
        self._flushed_ns = 0
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if any(self._folder.iterdir()):
                raise BagError(f'cannot record to {folder}: the folder is not empty')
            self._open_file()
        except BagError:
            raise
        except OSError as error:
            raise BagError(f'cannot record to {folder}: {error.strerror}') from error
        with self._writing():
            self._start_file()

    def add_topic(self, topic: str, type_name: str, qos: Sequence[QosProfile] = (), *,
                  schema: MessageSchema | None = None, encoding: str = 'cdr') -> None:
        """
        Add a topic with the QoS its publishers offer; BagError if it was added before.

        schema: the definition of its type where it is not the installed one.
        """
        if topic in self._topics:
            raise BagError(f'{self._path}: topic {topic} was added before')
        if type_name not in self._schemas:
            self._schemas[type_name] = schema or message_schema(type_name)
        type_hash = self._schemas[type_name].type_hash
        record = TopicRecord(topic, type_name, type_hash, tuple(qos), encoding)
        with self._writing():
            self._register(record)
            self._topics[topic] = record

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """
        Append a serialized message.

        log_time_ns is when it was received, publish_time_ns when it was sent, 0 if unknown;
        both UNIX time, in any order. BagError for an unknown topic and when the disk is full.
        """
        record = self._topics.get(topic)
        if record is None:
            raise BagError(f'{self._path}: topic {topic} was not added')
        check_times(topic, log_time_ns, publish_time_ns)
        with self._writing():
            if self._is_full(log_time_ns):
                self._finish_file()
                self._open_file()
                self._start_file()
            if len(cdr) >= self._options.chunk_size_bytes:
                # A large message has its own chunk: others can be read without unpacking it.
                self._writer.flush()
            if not self._files[-1].message_count:
                self._flushed_ns = log_time_ns
            self._writer.add_message(
                self._channel_ids[topic], log_time_ns, cdr, publish_time_ns or log_time_ns,
                sequence=record.message_count % 2 ** 32)
            record.message_count += 1
            self._files[-1].count(log_time_ns)
            if 0 < self._flush_ns <= abs(log_time_ns - self._flushed_ns):
                self._writer.flush()
                self._flushed_ns = log_time_ns

    def flush(self) -> None:
        """Pass all messages to the operating system, for times without new messages."""
        with self._writing():
            self._writer.flush()

    def close(self) -> None:
        """Write index and metadata; a second call does nothing."""
        if self._file.closed:
            return
        with self._writing():
            information = self._finish_file()
            text = to_yaml({'rosbag2_bagfile_information': information})
            (self._folder / 'metadata.yaml').write_text(text)

    def __enter__(self) -> 'BagWriter':
        self._open = ExitStack()
        self._open.enter_context(interrupted_by_ctrl_c())
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        with self._open:
            self.close()

    @property
    def _path(self) -> Path:
        return self._folder / self._files[-1].name

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn a failure of the disk into a BagError and close the file as it is."""
        if self._file.closed:
            raise BagError(f'{self._path} is closed')
        try:
            yield
        except OSError as error:
            with suppress(OSError):
                self._file.close()
            raise BagError(f'{self._path}: {error.strerror}: the recording ends here, what was '
                           'written before can be read') from error

    def _is_full(self, log_time_ns: int) -> bool:
        """Return whether a message belongs into a new file."""
        span_ns = self._files[-1].span_ns
        if span_ns is None:
            return False
        options = self._options
        return (0 < options.max_file_size_mb * 1e6 <= self._file.tell()
                or 0 < options.max_file_duration_s * 1e9 <= log_time_ns - span_ns[0])

    def _open_file(self) -> None:
        name = f'{self._folder.resolve().name}_{len(self._files)}.mcap'
        self._files.append(FileRecord(name))
        self._file = open(self._folder / name, 'xb')
        self._writer = Writer(self._file, chunk_size=self._options.chunk_size_bytes,
                              compression=CompressionType[self._options.compression.upper()])
        self._channel_ids: dict[str, int] = {}
        self._schema_ids: dict[str, int] = {}

    def _start_file(self) -> None:
        self._writer.start('ros2', f'startracker_ros {LIBRARY_IDENTIFIER}')
        self._write_information()
        for record in self._topics.values():
            self._register(record)
        self._writer.flush()

    def _register(self, record: TopicRecord) -> None:
        """Put schema and channel of a topic into the present file."""
        schema = self._schemas[record.type_name]
        if record.type_name not in self._schema_ids:
            self._schema_ids[record.type_name] = self._writer.register_schema(
                record.type_name, schema.encoding, schema.text.encode())
        self._channel_ids[record.name] = self._writer.register_channel(
            record.name, record.encoding, self._schema_ids[record.type_name], {
                'offered_qos_profiles': to_yaml([profile.as_dict() for profile in record.qos]),
                'topic_type_hash': record.type_hash})

    def _finish_file(self) -> dict:
        information = self._write_information()
        self._writer.finish()
        self._file.close()
        return information

    def _write_information(self) -> dict:
        """Put the metadata into the MCAP file too; rosbag2 does so at both ends of it."""
        information = bag_information(self._files, list(self._topics.values()))
        self._writer.add_metadata('rosbag2', {'serialized_metadata': to_yaml(information)})
        return information


def check_times(topic: str, log_time_ns: int, publish_time_ns: int) -> None:
    """Raise ValueError for times that a bag cannot hold."""
    if not (0 <= log_time_ns < 2 ** 64 and 0 <= publish_time_ns < 2 ** 64):
        raise ValueError(
            f'{topic}: times {log_time_ns}, {publish_time_ns} ns are not UNIX times')
