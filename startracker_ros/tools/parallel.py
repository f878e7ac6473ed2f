# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Independent trials of a campaign on the cores of this machine, or on a cluster."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
import os
from typing import Any

import numpy as np
from rich.progress import track
from startracker_ros.core.extras import extra
from startracker_ros.io.workers import Processes


def parallel_map(work: Callable[..., Any], pieces: Iterable[tuple], *, title: str,
                 scheduler: str = '') -> list[Any]:
    """
    Return work(*piece) of each piece, in order.

    work is a function of a module, its arguments can be pickled. scheduler is the address of
    a dask cluster; without one the pieces run on the cores of this machine, in processes whose
    libraries use one thread each. MissingLibraryError for a scheduler without dask.
    """
    pieces = list(pieces)
    if scheduler:
        with extra('scale', 'dask', 'A scheduler'):
            from dask.distributed import Client
        with Client(scheduler) as client:
            return client.gather([client.submit(work, *piece, pure=False) for piece in pieces])
    os.environ.update(OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1')
    with Processes() as executor:
        done = [executor.submit(work, *piece) for piece in pieces]
        return [each.result() for each in track(done, title, transient=True)]


def split_trials(trials: int, size: int, seed: int) -> list[tuple[int, int]]:
    """
    Return parts (trials, seed) of at most size trials; the seeds follow from the first.

    The parts do not depend on the machine, so the figures do not either.
    """
    return [(min(size, trials - begin), seed * 1_000_003 + begin)
            for begin in range(0, trials, size)]


class Trials:
    """Trials of several kinds, to run side by side: the pool of processes starts only once."""

    def __init__(self) -> None:
        self._pieces: list[tuple] = []
        self._counts: list[int] = []

    def add(self, work: Callable[..., Any], case: tuple, trials: int, size: int, seed: int
            ) -> None:
        """Add trials of work(*case, trials, seed) in parts of at most size trials."""
        parts = split_trials(trials, size, seed)
        self._pieces += [(work, (*case, *part)) for part in parts]
        self._counts.append(len(parts))

    def run(self, *, title: str, scheduler: str = '') -> Iterator[Any]:
        """Yield the result of each kind in order, its parts joined; parallel_map() runs them."""
        results = iter(parallel_map(_call, self._pieces, title=title, scheduler=scheduler))
        for count in self._counts:
            yield joined([next(results) for _ in range(count)])


def _call(work: Callable[..., Any], arguments: tuple) -> Any:
    return work(*arguments)


def parallel_trials(work: Callable[..., Any], cases: Iterable[tuple], trials: int, size: int,
                    seed: int, *, title: str, scheduler: str = '') -> list[Any]:
    """Return the results of the same work on several cases, as those of Trials."""
    all_trials = Trials()
    for case in cases:
        all_trials.add(work, case, trials, size, seed)
    return list(all_trials.run(title=title, scheduler=scheduler))


def joined(parts: Sequence[Any]) -> Any:
    """
    Return the results of several parts as one.

    Arrays are concatenated along their first axis, also those in the fields of a dataclass and in
    the values of a dictionary; what can be added is added.
    """
    first, *others = parts
    if isinstance(first, np.ndarray):
        return np.concatenate(parts)
    if isinstance(first, dict):
        return {key: joined([part[key] for part in parts]) for key in first}
    if is_dataclass(first) and not hasattr(first, '__add__'):
        kind: Any = type(first)
        return kind(*(joined([getattr(part, column.name) for part in parts])
                      for column in fields(first)))
    return sum(others, first)
