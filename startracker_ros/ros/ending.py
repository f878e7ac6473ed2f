"""The end of a process by SIGINT or SIGTERM: between two callbacks of its nodes."""

from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
import signal
from threading import Thread
import time
from types import FrameType

PATIENCE_S = 1.0
"""Time that a callback under way is given before it is interrupted."""


class Ending:
    """
    Whether this process was asked to end, by a signal or by ask(), and interrupts what takes long.

    The signal handlers of rclpy end the context under whatever is done just then, and those of
    Python interrupt it anywhere. An events executor that takes in what a node has created is then
    left with callbacks that it does not know of, and aborts the process (rclpy 7.1.6).
    """

    def __init__(self) -> None:
        """Take the signals from now on; only the main thread can."""
        self.asked = self.interrupts = False
        self._awaited = False
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def ask(self) -> None:
        """Ask for the end, from any thread."""
        os.write(self._write, b'\0')

    @contextmanager
    def awaited(self, wake: Callable[[], object]) -> Iterator[None]:
        """
        Call wake() once the end is asked for, in a thread of its own.

        What goes on in this context for PATIENCE_S after that gets a KeyboardInterrupt.
        """
        self._awaited = True
        Thread(target=self._await, args=(wake,), name='end', daemon=True).start()
        try:
            yield
        finally:
            self._awaited = False

    def _await(self, wake: Callable[[], object]) -> None:
        os.read(self._read, 1)
        self.asked = True
        wake()
        time.sleep(PATIENCE_S)
        self.interrupts = True
        interrupt_main()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        """Be called in the main thread, between any two steps of it."""
        if self.interrupts and self._awaited:
            raise KeyboardInterrupt
