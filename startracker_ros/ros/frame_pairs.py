# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What two topics say of the same frame."""

from collections import Counter
from typing import Any

from startracker_ros.ros import qos


class FramePairs:
    """
    Pairs the values of two topics by stamp; either may come first.

    Each topic is in the order of its frames, so that no partner comes for what is older than a
    pair. Of each as many values wait as its queue holds; unpaired counts those that are dropped.
    """

    def __init__(self, *topics: str) -> None:
        self._waiting: dict[str, dict[int, Any]] = {topic: {} for topic in topics}
        self.unpaired: Counter[str] = Counter()

    def clear(self) -> None:
        """Forget what waits."""
        for waiting in self._waiting.values():
            waiting.clear()

    def waits(self, topic: str, stamp_ns: int) -> bool:
        """Return whether a value of a topic waits for the other of its frame."""
        return stamp_ns in self._waiting[topic]

    def add(self, topic: str, stamp_ns: int, value: Any) -> tuple[Any, ...] | None:
        """Add a value of a topic; return all of its frame in the order of topics, or None."""
        self._waiting[topic][stamp_ns] = value
        complete = all(stamp_ns in waiting for waiting in self._waiting.values())
        pair = (tuple(waiting.pop(stamp_ns) for waiting in self._waiting.values()) if complete
                else None)
        for name, waiting in self._waiting.items():
            while waiting and (len(waiting) > qos.LIST.depth
                               or complete and next(iter(waiting)) < stamp_ns):
                del waiting[next(iter(waiting))]
                self.unpaired[name] += 1
        return pair
