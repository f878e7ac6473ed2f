# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frequency and stamps of a topic, in the words of diagnostic_updater."""

from collections import deque
import time

from rclpy.clock import Clock
from startracker_ros.ros.diagnostics import OK, TaskResult, WARN

_WINDOW_REPORTS = 5


class TopicStatus:
    """
    The status '<topic> topic status', over the last five publications.

    The frequency is too low where stamps are missing: a bag may be played slower than it was
    recorded. A late stamp is a figure and no fault, as bags and simulations have old ones.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events = 0
        self._missing = 0
        self._delays_s: list[float] = []
        self.restart()

    def restart(self) -> None:
        """Begin a new window."""
        self._reports = deque([(time.monotonic(), self._events, self._missing)], _WINDOW_REPORTS)

    def arrived(self, stamp_ns: int, missing: int) -> None:
        """Count a message with its stamp and the number of those missing before it."""
        self._events += 1
        self._missing += missing
        self._delays_s.append((self._clock.now().nanoseconds - stamp_ns) * 1e-9)

    def run(self) -> TaskResult:
        """Return the level, message and values of this publication."""
        now_s = time.monotonic()
        begin_s, events, missing = self._reports[0]
        window_s, events, missing = now_s - begin_s, self._events - events, self._missing - missing
        self._reports.append((now_s, self._events, self._missing))
        delays_s, self._delays_s = self._delays_s, []
        values: dict[str, object] = {
            'Events in window': events, 'Events since startup': self._events,
            'Duration of window (s)': f'{window_s:.6f}',
            'Actual frequency (Hz)': f'{events / window_s if window_s else 0.0:.6f}',
            'Missing in window': missing}
        if delays_s:
            values |= {'Earliest timestamp delay:': f'{min(delays_s):.6f}',
                       'Latest timestamp delay:': f'{max(delays_s):.6f}'}
        if not events:
            return WARN, 'No events recorded.', values
        if missing:
            return WARN, 'Frequency too low.', values
        return OK, 'Desired frequency met', values
