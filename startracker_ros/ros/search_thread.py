# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches in a thread of their own, none of them late, while the executor stays free."""

from collections import deque
from collections.abc import Callable
from threading import Condition, Thread
import time
from typing import NamedTuple

import numpy as np
from rclpy.node import Node

Finish = Callable[[], None]
"""What the executor does with the result of a search."""

PATIENCE_S = 0.25
"""
After this time, or an interval of frames if that is longer, a search gives way to a newer one.

Several times what the hardest fields take that can be identified: 0.05 s of a processor.
"""


class _Search(NamedTuple):
    """A search, when it gives way, and the time.monotonic() (1,) that ends it."""

    run: Callable[[], Finish]
    deadline_s: float
    until_s: np.ndarray


class SearchThread:
    """
    Runs one search after the other, each of a newer frame, none of them late.

    A search is a function without arguments that runs in the thread and returns what the executor
    is to do then. It ends when the clock reaches until_s (1,), which it reads time and again: once
    a newer one waits, that is PATIENCE_S after the call of search(). One that could not even begin
    until then is dropped. What a search raises is raised by the next call of search().
    """

    def __init__(self, node: Node) -> None:
        self.dropped = 0
        self._changed = Condition()
        self._waiting: deque[_Search] = deque()
        self._running: _Search | None = None
        self._error: Exception | None = None
        self._node = node
        Thread(target=self._run, name=f'{node.get_name()} search', daemon=True).start()

    @property
    def is_running(self) -> bool:
        """Whether a search runs."""
        return self._running is not None

    def search(self, run: Callable[[], Finish], until_s: np.ndarray, interval_s: float) -> None:
        """Run a search after those that wait; interval_s is that of the frames."""
        if self._error is not None:
            raise self._error
        deadline_s = time.monotonic() + max(PATIENCE_S, interval_s)
        with self._changed:
            self._waiting.append(_Search(run, deadline_s, until_s))
            self._limit()
            self._changed.notify()

    def clear(self) -> None:
        """Forget the searches that wait, and end the one that runs."""
        with self._changed:
            self._waiting.clear()
            if self._running is not None:
                self._running.until_s[0] = 0.0

    def _limit(self) -> None:
        """Let the search that runs give way in time, if another one waits."""
        if self._waiting and self._running is not None:
            until_s = self._running.until_s
            until_s[0] = min(until_s[0], self._running.deadline_s)

    def _next(self) -> _Search:
        """Wait for a search and return it; it is the one that runs."""
        with self._changed:
            self._running = None
            while not self._waiting:
                self._changed.wait()
            while len(self._waiting) > 1 and self._waiting[0].deadline_s < time.monotonic():
                self._waiting.popleft()
                self.dropped += 1
            self._running = search = self._waiting.popleft()
            search.until_s[0] = np.inf
            self._limit()
            return search

    def _run(self) -> None:
        while True:
            finish = self._guarded(self._next().run)
            # No executor once the node is about to end.
            if finish is not None and self._node.executor is not None:
                self._node.executor.create_task(self._guarded, finish)

    def _guarded(self, work: Callable[[], Finish | None]) -> Finish | None:
        """Return what work() returns; a task that raised would end the process (rclpy 7.1.6)."""
        try:
            return work()
        except Exception as error:
            self._error = error
            return None
