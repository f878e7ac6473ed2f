"""Independent pieces of a campaign over the cores of this machine, or over a cluster."""

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import os
from typing import Any

from rich.progress import track
from startracker_ros.extras import extra


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
    # The libraries read the number of threads when they are imported: not in a forked process.
    with ProcessPoolExecutor(mp_context=get_context('spawn')) as executor:
        done = executor.map(work, *zip(*pieces))
        return list(track(done, title, total=len(pieces), transient=True))


def split(trials: int, size: int, seed: int) -> list[tuple[int, int]]:
    """
    Return pieces (trials, seed) of at most size trials; the seeds follow from the first.

    The pieces do not depend on the machine, so the figures do not either.
    """
    return [(min(size, trials - begin), seed * 1_000_003 + begin)
            for begin in range(0, trials, size)]
