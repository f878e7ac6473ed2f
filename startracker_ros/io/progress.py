# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far long work is, on stderr: a bar on a terminal, else a line every few seconds."""

from collections.abc import Callable, Iterable, Iterator
import sys
from threading import Event, Thread
import time
from typing import TypeVar

_Item = TypeVar('_Item')

EVERY_S = 5.0
_printed = True


def print_lines(printed: bool) -> None:
    """Set whether there are lines: next to a document for programs there are none."""
    global _printed
    _printed = printed


def progress(items: Iterable[_Item], title: str, total: int | None = None, *,
             name: Callable[[_Item], str] | None = None) -> Iterator[_Item]:
    """Yield items; name is what a line calls the one that is at work."""
    if sys.stderr.isatty() and total != 1:
        from rich.console import Console
        from rich.progress import track
        yield from track(items, title, total=total, console=Console(stderr=True), transient=True)
        return
    ended, count, at_work, begin_s = Event(), 0, '', time.monotonic()

    def report() -> None:
        of = '' if total is None else f' of {total}'
        while not ended.wait(EVERY_S):
            print(f'{title}: {at_work}{count}{of}, {time.monotonic() - begin_s:.0f} s',
                  file=sys.stderr, flush=True)

    if _printed:
        Thread(target=report, daemon=True).start()
    try:
        for item in items:
            count, at_work = count + 1, '' if name is None else f'{name(item)}, '
            yield item
    finally:
        ended.set()
