# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bag that is read as far as it is intact."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.reader import (
    BagMessage, BagTopic, read_messages, read_span_ns, read_topics)

_MAX_PROBLEMS = 100
"""Nobody reads more of them."""


class TolerantBag:
    """
    Reads what is intact of a bag; report(problem) is called once for each kind of damage.

    topics and span_ns (the first and last log time, None of an empty bag) are read at once;
    BagError if nothing can be read.
    """

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        self._path = path
        self._report = report
        self._problems: set[str] = set()
        self.topics = self._read_topics()
        self.span_ns = read_span_ns(path)

    def messages(self, topics: Sequence[str], start_ns: int) -> Iterator[BagMessage]:
        """Yield the messages of topics from a log time on."""
        return read_messages(self._path, topics=tuple(topics), start_ns=start_ns, tolerant=True,
                             report=self._on_damage)

    def _read_topics(self) -> dict[str, BagTopic]:
        try:
            return read_topics(self._path)
        except BagError as error:
            topics = read_topics(self._path, tolerant=True)
            self._on_damage(str(error))
            return topics

    def _on_damage(self, problem: str) -> None:
        if problem not in self._problems and len(self._problems) < _MAX_PROBLEMS:
            self._problems.add(problem)
            self._report(problem)
