# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which conditions are logged: each change once, not every frame."""

import re

_NUMBER = re.compile(r'[-+]?\d+(\.\d+)?([eE][-+]?\d+)?')


class Transitions:
    """
    Separates changes of a condition from repeats, which differ in their numbers at most.

    A condition that alternates with every frame must not flood the log: after a burst of lines,
    one line in period_s is logged, with the number of changes left out before it.
    """

    def __init__(self, *, burst: int = 10, period_s: float = 1.0) -> None:
        self._burst = self._allowance = float(burst)
        self._period_s = period_s
        self._condition: tuple[object, str] | None = None
        self._suppressed = 0
        self._newest_s: float | None = None

    def line(self, level: object, text: str, now_s: float) -> str | None:
        """Return the line to log for a condition at a time of the steady clock, if any."""
        condition = level, _NUMBER.sub('#', text)
        if condition == self._condition:
            return None
        self._condition = condition
        if self._newest_s is not None:
            gained = (now_s - self._newest_s) / self._period_s
            self._allowance = min(self._burst, self._allowance + gained)
        self._newest_s = now_s
        if self._allowance < 1:
            self._suppressed += 1
            return None
        self._allowance -= 1
        suppressed, self._suppressed = self._suppressed, 0
        return f'{text} ({suppressed} changes before were not logged)' if suppressed else text
