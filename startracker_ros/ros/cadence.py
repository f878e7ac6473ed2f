# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The usual interval between the frames of a topic, to detect missing frames and silence."""

from collections import deque

_REMEMBERED = 15
_MISSING_RATIO = 1.6
_SILENT_RATIO = 5.0
_SILENT_S = 1.0
_FORWARD_S = 1.0


class Cadence:
    """
    The last intervals of stamps and of arrivals; the usual one is their median.

    Arrivals are times of a steady clock in s: a recording may play faster than its stamps.
    """

    def __init__(self) -> None:
        self._stamp_ns: int | None = None
        self._arrived_s = 0.0
        self._stamp_steps_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._arrival_steps_s: deque[float] = deque(maxlen=_REMEMBERED)

    def arrived(self, stamp_ns: int, now_s: float) -> tuple[int, float]:
        """Record a frame; return the number missing before it, and the jump of time in s."""
        missing, ahead_s = 0, 0.0
        if self._stamp_ns is not None:
            step_s, waited_s = (stamp_ns - self._stamp_ns) * 1e-9, now_s - self._arrived_s
            usual_s = _usual(self._stamp_steps_s)
            if usual_s is not None and step_s > _MISSING_RATIO * usual_s:
                if step_s > 2 * (waited_s + usual_s) + _FORWARD_S:
                    ahead_s = step_s - waited_s
                else:
                    missing = round(step_s / usual_s) - 1
            if not ahead_s:
                self._stamp_steps_s.append(step_s)
            self._arrival_steps_s.append(waited_s)
        self._stamp_ns, self._arrived_s = stamp_ns, now_s
        return missing, ahead_s

    @property
    def interval_s(self) -> float | None:
        """The usual interval between arrivals, None while it is not known."""
        return _usual(self._arrival_steps_s)

    def is_silent(self, now_s: float) -> bool:
        """Return whether the next frame is long overdue."""
        usual_s = self.interval_s
        return usual_s is not None and (
            now_s - self._arrived_s > max(_SILENT_S, _SILENT_RATIO * usual_s))


def _usual(steps_s: deque[float]) -> float | None:
    """Return the median, None of fewer than three."""
    return sorted(steps_s)[len(steps_s) // 2] if len(steps_s) >= 3 else None
