# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node builds for a camera, in a thread, and the messages that wait for it."""

from collections import Counter, deque
from collections.abc import Callable
from threading import Lock, Thread
from typing import Any

from startracker_ros.core.camera.model import Camera

# One after the other: the nodes of a process share catalogues, which are built once then.
_BUILDING = Lock()


def is_building() -> bool:
    """Return whether a thread of this process builds something for a camera."""
    return _BUILDING.locked()


class CameraSetup:
    """Calls build() in a thread; it must not use anything that the node changes meanwhile."""

    def __init__(self, camera: Camera, epoch_year: float, build: Callable[[], Any]) -> None:
        self.camera = camera
        self.epoch_year = epoch_year
        self._build = build
        self._built: Any = None
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, name='camera set-up', daemon=True)
        self._thread.start()

    @property
    def is_done(self) -> bool:
        """Whether build() has ended."""
        return not self._thread.is_alive()

    def built(self) -> Any:
        """Return what build() has returned, or raise what it has raised."""
        if self._error is not None:
            raise self._error
        return self._built

    def _run(self) -> None:
        with _BUILDING:
            try:
                self._built = self._build()
            except BaseException as error:
                self._error = error


class WaitingMessages:
    """Messages in the order of their arrival, of each topic a bounded number of the newest."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[str, Callable[[], None]]] = deque()
        self._counts: Counter[str] = Counter()

    def add(self, topic: str, process: Callable[[], None], depth: int) -> bool:
        """Keep the processing of a message; return whether the oldest was dropped for it."""
        self._waiting.append((topic, process))
        self._counts[topic] += 1
        if self._counts[topic] <= depth:
            return False
        del self._waiting[next(index for index, entry in enumerate(self._waiting)
                               if entry[0] == topic)]
        self._counts[topic] -= 1
        return True

    def process(self) -> None:
        """Process all."""
        while self._waiting:
            topic, process = self._waiting.popleft()
            self._counts[topic] -= 1
            process()

    def clear(self) -> list[str]:
        """Drop all; return their topics."""
        topics = [topic for topic, _ in self._waiting]
        self._waiting.clear()
        self._counts.clear()
        return topics
