# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shutdown of a process on SIGINT or SIGTERM, between two callbacks of its nodes."""

from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
import signal
from threading import Thread
import time
from types import FrameType

GRACE_PERIOD_S = 1.0
"""Time for a running callback to finish before it is interrupted."""


class Shutdown:
    """
    Whether shutdown was requested, by a signal or by request().

    The signal handlers of rclpy invalidate the context at once, and those of Python raise between
    any two instructions. Both can leave an events executor with callbacks that it does not know,
    and it then aborts the process (rclpy 7.1.6).
    """

    def __init__(self) -> None:
        """Install the signal handlers; only the main thread can."""
        self.requested = self.interrupts = False
        self._spinning = False
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def request(self) -> None:
        """Request shutdown, from any thread."""
        os.write(self._write, b'\0')

    @contextmanager
    def while_spinning(self, wake: Callable[[], object]) -> Iterator[None]:
        """
        Call wake() in another thread when shutdown is requested.

        A callback that runs GRACE_PERIOD_S longer is interrupted by a KeyboardInterrupt.
        """
        self._spinning = True
        Thread(target=self._wait, args=(wake,), name='shutdown', daemon=True).start()
        try:
            yield
        finally:
            self._spinning = False

    def _wait(self, wake: Callable[[], object]) -> None:
        os.read(self._read, 1)
        self.requested = True
        wake()
        time.sleep(GRACE_PERIOD_S)
        self.interrupts = True
        interrupt_main()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        """Run in the main thread, between any two instructions."""
        if self.interrupts and self._spinning:
            raise KeyboardInterrupt
