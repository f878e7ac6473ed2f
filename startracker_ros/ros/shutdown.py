# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shutdown of a process on a signal, between two callbacks, and exit where it may hang."""

from _thread import interrupt_main
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import ctypes
import os
import signal
import sys
from threading import Thread
import time
from types import FrameType

GRACE_PERIOD_S = 1.0
"""Time for a running callback to finish before it is interrupted."""

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2


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
        self.code = 0
        self._spinning = False
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        # `startracker run` blocks it while the node is imported.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def request(self, code: int = 0) -> None:
        """Request shutdown, from any thread, with the exit code of the process."""
        self.code = code
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


class _SignalEvent(ctypes.Structure):
    """struct sigevent of Linux, 64 bit."""

    _fields_ = [('value', ctypes.c_int), ('unused', ctypes.c_int), ('signal', ctypes.c_int),
                ('notify', ctypes.c_int), ('function', ctypes.c_void_p),
                ('attributes', ctypes.c_void_p), ('padding', ctypes.c_char * 32)]


class _TimerTime(ctypes.Structure):
    """struct itimerspec: the interval, and the time to the first expiry, in s and ns."""

    _fields_ = [('interval_s', ctypes.c_long), ('interval_ns', ctypes.c_long),
                ('value_s', ctypes.c_long), ('value_ns', ctypes.c_long)]


def exit_after(seconds: float, code: int) -> None:
    """
    End this process with an exit code after a time, whatever it is doing then.

    Fast DDS may spin for ever while it removes a participant, if another one leaves at the same
    time (eProsima/Fast-DDS issue 6513). It then holds the interpreter lock, so that a Python
    thread could not run: a timer of the system calls _exit(). Linux only.
    """
    if not sys.platform.startswith('linux'):
        return
    libc = ctypes.CDLL(None)
    event = _SignalEvent(value=code, notify=_SIGEV_THREAD,
                         function=ctypes.cast(libc._exit, ctypes.c_void_p).value)
    timer = ctypes.c_void_p()
    whole_s = int(seconds)
    when = _TimerTime(0, 0, whole_s, round((seconds - whole_s) * 1e9))
    if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        libc.timer_settime(timer, 0, ctypes.byref(when), None)
