"""Independent pieces of a campaign over the cores of this machine, or over a cluster."""

from collections.abc import Callable, Iterable
import os
from typing import Any

import dask
from dask.callbacks import Callback
from rich.progress import Progress


class _Bar(Callback):
    """Shows how many pieces are done."""

    def __init__(self, progress: Progress, title: str, count: int) -> None:
        task = progress.add_task(title, total=count)
        super().__init__(posttask=lambda *_: progress.advance(task))


def spread(work: Callable[..., Any], pieces: Iterable[tuple], *, title: str,
           scheduler: str = '') -> list[Any]:
    """
    Return work(*piece) of each piece, in order.

    work is a function of a module, its arguments can be pickled. scheduler is the address of
    a dask cluster; without one the pieces go over the cores of this machine, each worker a
    process whose libraries keep to one thread.
    """
    tasks = [dask.delayed(work, pure=False)(*piece) for piece in pieces]
    if scheduler:
        from dask.distributed import Client
        with Client(scheduler):
            return list(dask.compute(*tasks))
    os.environ.update(OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1')
    with Progress(transient=True) as progress, _Bar(progress, title, len(tasks)):
        return list(dask.compute(*tasks, scheduler='processes', num_workers=os.cpu_count()))


def split(trials: int, size: int, seed: int) -> list[tuple[int, int]]:
    """
    Return pieces (trials, seed) of at most size trials; the seeds follow from the first.

    The pieces do not depend on the machine, so the figures do not either.
    """
    return [(min(size, trials - begin), seed * 1_000_003 + begin)
            for begin in range(0, trials, size)]
