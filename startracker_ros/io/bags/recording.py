# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recording that continues in a new bag after the disk has failed, without ROS."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import shutil
import threading
import time
from types import TracebackType

from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.writer import BagOptions, BagWriter, check_times

_RETRY_S = 5.0
"""Time between two attempts to continue after a failure."""

# Period and writing time together stay well below the 1 s that may be lost.
_FLUSH_PERIOD_S = 0.5


class BackgroundWriter:
    """
    A queue in front of a BagWriter; write() only appends to it.

    dropped counts the messages that met a full queue or a failed bag; error is why the bag
    failed, None otherwise.
    """

    def __init__(self, writer: BagWriter, *, queue_bytes: int) -> None:
        self._writer = writer
        self._free_bytes = queue_bytes
        self._queue: deque[tuple[str, bytes, int, int]] = deque()
        self._changed = threading.Condition()
        self._writer_lock = threading.Lock()
        self._closing = False
        self.dropped = 0
        self.error: BagError | None = None
        self._thread = threading.Thread(target=self._write_queued, name='bag writer', daemon=True)
        self._thread.start()

    def add_topic(self, name: str, type_name: str, qos: Sequence[QosProfile] = ()) -> None:
        """Add a topic to the bag; errors as those of the BagWriter."""
        with self._writer_lock:
            self._writer.add_topic(name, type_name, qos)

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """Queue a message for the writer; return False and count it if it is dropped."""
        check_times(topic, log_time_ns, publish_time_ns)
        with self._changed:
            # A message larger than the whole queue still goes through an empty one.
            if self.error is not None or (self._queue and len(cdr) > self._free_bytes):
                self.dropped += 1
                return False
            self._free_bytes -= len(cdr)
            self._queue.append((topic, cdr, log_time_ns, publish_time_ns))
            self._changed.notify()
            return True

    def close(self) -> None:
        """Write the queue, index and metadata; BagError if that fails."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        self._writer.close()

    def __enter__(self) -> 'BackgroundWriter':
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def _write_queued(self) -> None:
        flushed_s = time.monotonic()
        try:
            while True:
                with self._changed:
                    if not self._queue and not self._closing:
                        self._changed.wait(_FLUSH_PERIOD_S)
                    message = self._queue.popleft() if self._queue else None
                    if message is None and self._closing:
                        return
                with self._writer_lock:
                    if message is not None:
                        self._writer.write(*message)
                    if time.monotonic() - flushed_s >= _FLUSH_PERIOD_S:
                        self._writer.flush()
                        flushed_s = time.monotonic()
                if message is not None:
                    with self._changed:
                        self._free_bytes += len(message[1])
        except BagError as error:
            with self._changed:
                self.error = error
                # The current message may be lost as well.
                self.dropped += len(self._queue) + (message is not None)
                self._queue.clear()


@dataclass(frozen=True)
class RecordOptions(Options):
    """What is recorded, and where."""

    folder: str = option('', 'new folder of the bag; empty for startracker_<date>_<time>',
                         read_only=True)
    topics: tuple[str, ...] = option(('*',), 'patterns of full topic names, * for any characters',
                                     read_only=True)
    exclude: tuple[str, ...] = option(
        ('*/image_annotated', '*/transition_event'), 'patterns of topics left out; '
        'image_annotated is drawn only for subscribers and can be drawn again, the states of the '
        'nodes are in /diagnostics', read_only=True)
    queue_depth: int = option(100, 'messages of a topic that wait for the recorder; rates of a '
                              'gyro are 1000 or more', low=1, high=10000, read_only=True)
    queue_size_mb: float = option(
        256.0, 'messages of all topics that wait for compression and disk; what does not fit is '
        'dropped and counted', unit='MB', low=1.0, high=65536.0, read_only=True)
    discovery_period_s: float = option(0.1, 'time between two searches for new topics', unit='s',
                                       low=0.01, high=60.0, read_only=True)


class Recording:
    """
    Writes messages to a bag; after a failure to <folder>_2, _3 and so on.

    folder is the current bag, error why it failed (None while all is well). BagError if the
    first bag cannot be created.
    """

    def __init__(self, options: RecordOptions, bag_options: BagOptions) -> None:
        self._bag_options = bag_options
        self._queue_bytes = round(options.queue_size_mb * 1e6)
        self._first_folder = self.folder = Path(
            options.folder or time.strftime('startracker_%Y_%m_%d-%H_%M_%S'))
        self._topics: dict[str, tuple[str, Sequence[QosProfile]]] = {}
        self._dropped_before = 0
        self._failed_s: float | None = None
        self._writer = self._open(self.folder)

    @property
    def error(self) -> BagError | None:
        """Why the current bag failed."""
        return self._writer.error

    @property
    def dropped(self) -> int:
        """Return the number of messages that found the queue full or the disk failed."""
        return self._dropped_before + self._writer.dropped

    def add_topic(self, topic: str, type_name: str, qos: Sequence[QosProfile]) -> None:
        """Add a topic to this bag and those that follow; BagError if its type is unknown."""
        if self._writer.error is None:
            self._writer.add_topic(topic, type_name, qos)
        self._topics[topic] = type_name, qos

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """Queue a serialized message; return False, and count it, if it is lost."""
        return self._writer.write(topic, cdr, log_time_ns, publish_time_ns)

    def retry(self) -> bool:
        """After a failure, try now and then to continue; return whether a new bag was started."""
        if self._writer.error is None:
            return False
        if self._failed_s is None:
            self._failed_s = time.monotonic()
        if time.monotonic() <= self._failed_s + _RETRY_S:
            return False
        self._failed_s = None
        return self._continue()

    def close(self) -> None:
        """Write what is queued, index and metadata; BagError if that fails."""
        self._writer.close()

    def _open(self, folder: Path) -> BackgroundWriter:
        return BackgroundWriter(BagWriter(folder, options=self._bag_options),
                                queue_bytes=self._queue_bytes)

    def _continue(self) -> bool:
        """Begin a new bag if the disk has room for the queue."""
        number = 2
        while (folder := self._first_folder.with_name(
                f'{self._first_folder.name}_{number}')).exists():
            number += 1
        try:
            if shutil.disk_usage(folder.absolute().parent).free < self._queue_bytes:
                return False
            writer = self._open(folder)
            for topic, (type_name, qos) in self._topics.items():
                writer.add_topic(topic, type_name, qos)
        except (BagError, OSError):
            # Created just now, and empty.
            shutil.rmtree(folder, ignore_errors=True)
            return False
        self._dropped_before += self._writer.dropped
        self._writer, self.folder = writer, folder
        return True
