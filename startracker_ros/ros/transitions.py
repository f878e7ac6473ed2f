"""Which conditions are worth a line in the log: each that is new, none of every frame."""

import re

_NUMBER = re.compile(r'[-+]?\d+(\.\d+)?([eE][-+]?\d+)?')


class Transitions:
    """
    Tells changes of a condition from repeats, which differ in their numbers at most.

    A condition that swings with every frame must not flood the log: after a burst of lines
    one in period_s goes through, and says how many changes it stands for.
    """

    def __init__(self, *, burst: int = 10, period_s: float = 1.0) -> None:
        self._burst = self._room = float(burst)
        self._period_s = period_s
        self._kept: tuple[object, str] | None = None
        self._untold = 0
        self._newest_s: float | None = None

    def line(self, level: object, text: str, now_s: float) -> str | None:
        """Return the line to log about a condition at a time of the steady clock, if any."""
        kept = level, _NUMBER.sub('#', text)
        if kept == self._kept:
            return None
        self._kept = kept
        if self._newest_s is not None:
            gained = (now_s - self._newest_s) / self._period_s
            self._room = min(self._burst, self._room + gained)
        self._newest_s = now_s
        if self._room < 1:
            self._untold += 1
            return None
        self._room -= 1
        untold, self._untold = self._untold, 0
        return f'{text} ({untold} changes before were not logged)' if untold else text
