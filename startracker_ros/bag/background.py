"""Writes a bag in a thread of its own, so that compression and disk keep no subscriber waiting."""

from collections import deque
from collections.abc import Sequence
import threading
import time
from types import TracebackType

from startracker_ros.bag.errors import BagError
from startracker_ros.bag.qos import QosProfile
from startracker_ros.bag.writer import BagWriter, check_times

# Together with the time of writing a flush stays well within the second that may be lost.
_FLUSH_PERIOD_S = 0.5


class BackgroundWriter:
    """
    A queue in front of a BagWriter; write() takes no longer than noting the message.

    dropped counts the messages that found the queue full, or a bag that had failed; error is
    why it failed, None while all is well.
    """

    def __init__(self, writer: BagWriter, *, queue_bytes: int) -> None:
        self._writer = writer
        self._room = queue_bytes
        self._queue: deque[tuple[str, bytes, int, int]] = deque()
        self._changed = threading.Condition()
        self._writer_lock = threading.Lock()
        self._closing = False
        self.dropped = 0
        self.error: BagError | None = None
        self._thread = threading.Thread(target=self._work, name='bag writer', daemon=True)
        self._thread.start()

    def add_topic(self, name: str, type_name: str, qos: Sequence[QosProfile] = ()) -> None:
        """Take up a topic, as the writer does."""
        with self._writer_lock:
            self._writer.add_topic(name, type_name, qos)

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """Queue a message for the writer; return False, and count it, if it is lost."""
        check_times(topic, log_time_ns, publish_time_ns)
        with self._changed:
            # A message larger than the whole queue still goes through an empty one.
            if self.error is not None or (self._queue and len(cdr) > self._room):
                self.dropped += 1
                return False
            self._room -= len(cdr)
            self._queue.append((topic, cdr, log_time_ns, publish_time_ns))
            self._changed.notify()
            return True

    def close(self) -> None:
        """Write what is queued, index and metadata; BagError if that fails."""
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

    def _work(self) -> None:
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
                        self._room += len(message[1])
        except BagError as error:
            with self._changed:
                self.error = error
                # The message under way may be lost as well; it is counted with the others.
                self.dropped += len(self._queue) + (message is not None)
                self._queue.clear()
