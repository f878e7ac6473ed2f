# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Independent trials of a campaign on the cores of this machine, or on a cluster."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
import os
from typing import Any, TypeVar

import numpy as np
from rich.progress import track
from startracker_ros.core.extras import extra
from startracker_ros.io.workers import Processes

_Arrays = TypeVar('_Arrays')


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


def parallel_trials(work: Callable[..., Any], cases: Iterable[tuple], trials: int, size: int,
                    seed: int, *, title: str, scheduler: str = '') -> list[list[Any]]:
    """
    Return for each case the results of its parts of at most size trials.

    work is called with the case, the trials of the part and its seed; the parts of all cases run
    side by side as in parallel_map().
    """
    cases, parts = list(cases), split_trials(trials, size, seed)
    results = iter(parallel_map(work, [(*case, *part) for case in cases for part in parts],
                                title=title, scheduler=scheduler))
    return [[next(results) for _ in parts] for _ in cases]


def concatenated(parts: Sequence[_Arrays]) -> _Arrays:
    """Return dataclasses of arrays as one, each field concatenated along its first axis."""
    kind: Any = type(parts[0])
    return kind(*(np.concatenate([getattr(part, column.name) for part in parts])
                  for column in fields(kind)))
