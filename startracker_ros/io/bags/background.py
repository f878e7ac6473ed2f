# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a bag in its own thread, so that compression and disk do not block subscribers."""

from collections import deque
from collections.abc import Sequence
import threading
import time
from types import TracebackType

from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.writer import BagWriter, check_times

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
