# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exit of a process whose main thread may hang."""

import ctypes
import sys

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2


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
