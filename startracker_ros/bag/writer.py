"""Writes a bag as rosbag2 (Jazzy, storage mcap) writes it, so that its tools read and play it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer

from startracker_ros.bag.errors import BagError
from startracker_ros.bag.metadata import bag_information, to_yaml, TopicRecord
from startracker_ros.bag.qos import QosProfile
from startracker_ros.bag.schemas import message_schema
from startracker_ros.options import option, Options

# So much log time is lost at most when the process is killed.
_FLUSH_NS = 10 ** 9


@dataclass(frozen=True)
class BagOptions(Options):
    """How a bag is laid out on disk."""

    compression: str = option(
        'lz4', 'of the chunks: zstd halves what lz4 leaves of noisy images in nearly twice the '
        'time', choices=('none', 'lz4', 'zstd'), read_only=True)
    chunk_size_bytes: int = option(
        2 ** 20, 'a chunk is closed when it is larger', unit='byte', low=2 ** 12, high=2 ** 30,
        read_only=True)


@dataclass
class _Channel:
    id: int
    record: TopicRecord


class BagWriter:
    """A bag being written: a folder with one MCAP file, and metadata.yaml once it is closed.

    What was written reaches the operating system within 1 s of log time: it outlives the
    process, not a power cut. After a BagError from write() or flush() the bag is closed and
    what came before is readable.
    """

    def __init__(self, folder: Path, *, options: BagOptions = BagOptions()) -> None:
        """Make the folder; BagError if it holds something or cannot be written."""
        self._folder = Path(folder)
        self._file_name = f'{self._folder.resolve().name}_0.mcap'
        self._channels: dict[str, _Channel] = {}
        self._schema_ids: dict[str, int] = {}
        self._span_ns: tuple[int, int] | None = None
        self._flushed_ns = 0
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if any(self._folder.iterdir()):
                raise BagError(f'cannot record to {folder}: the folder is not empty')
            self._file = open(self._folder / self._file_name, 'xb')
        except BagError:
            raise
        except OSError as error:
            raise BagError(f'cannot record to {folder}: {error.strerror}') from error
        self._writer = Writer(self._file, chunk_size=options.chunk_size_bytes,
                              compression=CompressionType[options.compression.upper()])
        with self._writing():
            self._writer.start('ros2', f'startracker_ros {LIBRARY_IDENTIFIER}')
            self._write_information()
            self._writer.flush()

    def add_topic(self, topic: str, type_name: str, qos: Sequence[QosProfile] = ()) -> None:
        """Take up a topic with what its publishers offer; BagError if it is there already."""
        if topic in self._channels:
            raise BagError(f'{self._path}: topic {topic} was added before')
        schema = message_schema(type_name)
        record = TopicRecord(topic, type_name, schema.type_hash, tuple(qos))
        with self._writing():
            if type_name not in self._schema_ids:
                self._schema_ids[type_name] = self._writer.register_schema(
                    type_name, schema.encoding, schema.text.encode())
            channel_id = self._writer.register_channel(topic, 'cdr', self._schema_ids[type_name], {
                'offered_qos_profiles': to_yaml([profile.as_dict() for profile in qos]),
                'topic_type_hash': schema.type_hash})
            self._channels[topic] = _Channel(channel_id, record)

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append a serialized message.

        log_time_ns is when it was received, publish_time_ns when it was sent, 0 if unknown;
        both UNIX time, in any order. BagError for an unknown topic and when the disk is full.
        """
        channel = self._channels.get(topic)
        if channel is None:
            raise BagError(f'{self._path}: topic {topic} was not added')
        if not (0 <= log_time_ns < 2 ** 64 and 0 <= publish_time_ns < 2 ** 64):
            raise ValueError(f'{topic}: times {log_time_ns}, {publish_time_ns} ns are not '
                             'UNIX times')
        with self._writing():
            self._writer.add_message(
                channel.id, log_time_ns, cdr, publish_time_ns or log_time_ns,
                sequence=channel.record.message_count % 2 ** 32)
            channel.record.message_count += 1
            if self._span_ns is None:
                self._span_ns = log_time_ns, log_time_ns
                self._flushed_ns = log_time_ns
            start_ns, end_ns = self._span_ns
            self._span_ns = min(start_ns, log_time_ns), max(end_ns, log_time_ns)
            if abs(log_time_ns - self._flushed_ns) >= _FLUSH_NS:
                self._writer.flush()
                self._flushed_ns = log_time_ns

    def flush(self) -> None:
        """Hand all messages to the operating system; for the time when none come in."""
        with self._writing():
            self._writer.flush()

    def close(self) -> None:
        """Write index and metadata; nothing happens when the bag is closed already."""
        if self._file.closed:
            return
        with self._writing():
            information = self._write_information()
            self._writer.finish()
            self._file.close()
            text = to_yaml({'rosbag2_bagfile_information': information})
            (self._folder / 'metadata.yaml').write_text(text)

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    @property
    def _path(self) -> Path:
        return self._folder / self._file_name

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

    def _write_information(self) -> dict:
        """Put the metadata into the MCAP file too; rosbag2 does so at both ends of it."""
        topics = [channel.record for channel in self._channels.values()]
        information = bag_information(self._file_name, topics, self._span_ns)
        self._writer.add_metadata('rosbag2', {'serialized_metadata': to_yaml(information)})
        return information
