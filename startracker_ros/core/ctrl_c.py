# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Ctrl-C of a command: it ends at once, whatever it is doing.

Python calls the handler of a signal between two of its instructions: not before a call of
the native core has returned. So a thread ends the process. It can run while no other one holds
the lock of the interpreter: the native core releases it. What has to be closed in order has an
exception all the same.
"""

import atexit
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path
import signal
from threading import current_thread, Event, Lock, main_thread, Thread
from types import FrameType

INTERRUPTED = 130
"""Exit status after Ctrl-C, as that of a shell."""

_SHOW_CURSOR = b'\r\x1b[?25h\x1b[K'

_MOST_TO_START_S = 0.2
"""That a process which is being started has, to be among those that Ctrl-C ends."""

_unfinished: dict[Path, None] = {}
_starting = Lock()


def end_at_once() -> None:
    """End this process by Ctrl-C from now on; only the main thread can call this."""
    # What a shell starts in the background ignores Ctrl-C.
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _at_once)
    # The end of the interpreter would have it end the process by the signal.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    Thread(target=_wait, args=(read,), name='ctrl-c', daemon=True).start()


def _at_once(number: int, frame: FrameType | None) -> None:
    """Leave the signal to the thread."""


def _wait(read: int) -> None:
    # A byte is the number of a signal.
    while numbers := os.read(read, 1):
        if numbers[0] == signal.SIGINT and signal.getsignal(signal.SIGINT) is _at_once:
            _stop()


def _stop() -> None:
    """End this process and those that it has started, and delete what it has half written."""
    # Whoever starts a process ends that, and starts no further one.
    _starting.acquire(timeout=_MOST_TO_START_S)
    started = _descendants(os.getpid())
    for path in list(_unfinished):
        with suppress(OSError):
            path.unlink()
    # Not by sys.stderr, which another thread may have locked.
    with suppress(OSError):
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b'') + b'startracker: stopped\n')
    # From here on no other thread runs, which would report that its processes are gone.
    for pid in started:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    os._exit(INTERRUPTED)


def _descendants(pid: int) -> list[int]:
    """Return the processes that one has started, and those that these have started."""
    found = []
    for path in Path('/proc', str(pid), 'task').glob('*/children'):
        with suppress(OSError):
            for child in map(int, path.read_text().split()):
                found += [child, *_descendants(child)]
    return found


@contextmanager
def deleted_by_ctrl_c(path: Path) -> Iterator[None]:
    """Have a file deleted where Ctrl-C ends this process meanwhile."""
    _unfinished[path] = None
    try:
        yield
    finally:
        del _unfinished[path]


@contextmanager
def interrupted_by_ctrl_c() -> Iterator[None]:
    """Have Ctrl-C raise KeyboardInterrupt meanwhile, to close what has to be closed."""
    if current_thread() is main_thread() and signal.getsignal(signal.SIGINT) is _at_once:
        with _handled_by(signal.default_int_handler):
            yield
    else:
        yield


@contextmanager
def noted_ctrl_c() -> Iterator[Event]:
    """Yield what Ctrl-C sets meanwhile, instead of an exception."""
    event = Event()
    with _handled_by(lambda *_: event.set()):
        yield event


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Have a handler of Ctrl-C, and of the end of the terminal, which ends no nodes."""
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGHUP)
              if signal.getsignal(number) is not signal.SIG_IGN}
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, handler_before)


@contextmanager
def no_ctrl_c_in_children() -> Iterator[None]:
    """
    Take Ctrl-C afterwards, and never in the processes that are started meanwhile.

    They inherit what is blocked. A terminal sends it to all of them; this process ends them.
    """
    with _starting:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
