# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tasks on processes of this machine or on a dask cluster, which replaces lost workers."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from contextlib import contextmanager
from itertools import islice
import logging
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from multiprocessing.connection import wait
import os
from threading import Thread
from typing import Any

from startracker_ros.core.ctrl_c import no_ctrl_c_in_children
from startracker_ros.core.extras import extra

MEMORY_LIMIT = '2GiB'
"""Of a local worker: one that needs more is ended, and its task fails."""

MOST_TASKS = 10_000
"""That a scheduler has at a time: its memory does not grow with those that are to come."""


class SchedulerLostError(OSError):
    """The scheduler of a dask cluster ended, and no other took its address in time."""


def default_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


class Processes(ProcessPoolExecutor):
    """
    New processes, by default one for each core, that end at once with the command or by Ctrl-C.

    They end as well where the command is killed.

    They are not forked: libraries read the number of threads when they are imported.
    """

    def __init__(self, workers: int | None = None) -> None:
        super().__init__(workers, mp_context=get_context('spawn'), initializer=_end_with_parent)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any
               ) -> Future[Any]:
        # It starts processes.
        # Its start would unblock the signal.
        resource_tracker.ensure_running()
        with no_ctrl_c_in_children():
            return super().submit(function, *arguments, **options)

    def __exit__(self, kind: type[BaseException] | None, *error: Any) -> None:
        if kind is not None:
            for process in active_children():
                process.terminate()
        super().__exit__(kind, *error)


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, in whatever way."""
    parent = parent_process()
    assert parent is not None

    def end() -> None:
        wait([parent.sentinel])
        os._exit(1)
    Thread(target=end, name='parent', daemon=True).start()


@contextmanager
def cluster(workers: int, scheduler: str = '') -> Iterator[Any]:
    """
    Yield a dask client: of a scheduler at an address, or of local processes of one thread each.

    MissingLibraryError without dask; OSError where no scheduler is found.
    """
    with extra('scale', 'dask', 'A run on several workers'):
        import dask
        from dask.distributed import Client, LocalCluster
    if scheduler:
        # Of a lost connection it prints tracebacks; SchedulerLostError says it in a line.
        for name in 'distributed', 'distributed.client':
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with Client(scheduler) as client:
            yield client
        return
    # The profiler of dask interrupts a worker every 10 ms, which takes 6 % of its time.
    with dask.config.set({'distributed.worker.profile.enabled': False}):
        resource_tracker.ensure_running()
        with no_ctrl_c_in_children():
            local = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True,
                                 memory_limit=MEMORY_LIMIT, dashboard_address=':0',
                                 silence_logs=logging.CRITICAL)
        with local, Client(local) as client:
            yield client


def completed(client: Any, function: Callable[..., Any], tasks: Sequence[tuple]
              ) -> Iterator[tuple[int, Any]]:
    """
    Yield the index and the result of function(*task) of each task, as they end.

    The result of a task that failed is its exception. dask repeats the task of a lost worker on
    another one, up to three times; those of a lost scheduler go to the one that takes its place,
    and SchedulerLostError is raised where none does.
    """
    from dask.distributed import as_completed
    index: dict[Any, int] = {}
    running = as_completed()

    def submit(numbers: Iterable[int]) -> None:
        for number in numbers:
            future = client.submit(function, *tasks[number], pure=False)
            index[future] = number
            running.add(future)
    address, waiting = client.scheduler.address, iter(range(len(tasks)))
    submit(islice(waiting, MOST_TASKS))
    for batch in running.batches():
        results = _results(client, batch)
        for future in batch:
            number = index.pop(future)
            if future in results:
                yield number, results[future]
                submit(islice(waiting, 1))
            elif client.status in ('running', 'connecting'):
                submit([number])
            else:
                raise SchedulerLostError(f'the scheduler {address} was lost and did not come back')


def _results(client: Any, ended: Sequence[Any]) -> dict[Any, Any]:
    """Return results or exceptions of tasks, without those that were lost with the scheduler."""
    results: dict[Any, Any] = {}
    finished = [future for future in ended if future.status == 'finished']
    # as_completed(with_results=True) would never yield one that is lost while it is fetched.
    try:
        results.update((future, future.exception()) for future in ended
                       if future.status == 'error')
        results.update(zip(finished, client.gather(finished)))
    except (OSError, CancelledError):
        pass
    except Exception:
        # A client that has closed raises anything.
        if client.status == 'running':
            raise
    return results
