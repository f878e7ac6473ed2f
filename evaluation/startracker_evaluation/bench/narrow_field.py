# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lost in space in fields of 2 and 3 deg with the deep catalogue: share, time, database."""

from collections.abc import Iterator
import ctypes
import os
import tempfile
import time

import numpy as np
import psutil
from startracker_evaluation.bench.corpus import Cell, frames, View
from startracker_evaluation.bench.lost_in_space import CORRECT, kind_of, Outcome, WRONG
from startracker_evaluation.bench.peers import Ours, timed_attitudes, WARM_UP, WARM_UP_VIEW
from startracker_ros.io.workers import Processes
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.parallel import parallel_trials

VIEWS = {view.name: view for view in (
    View('N3', 1024, 3.0, 9.5), View('N2', 1024, 2.0, 10.0))}

NARROW_CONDITIONS = '; '.join(
    f'{view.name}: {view.fov_deg:g} deg, {view.width} px, V {view.magnitude_limit:g}'
    for view in VIEWS.values()) + '; random attitudes, a noise of 0.2 px, a tenth of the trials'

_SOLVED_PERCENT = {'N3': 99.0, 'N2': 97.0}
_CELL = Cell(0.2)
_PART_TRIALS = 500


def solve_frames(view: View, trials: int, seed: int) -> Outcome:
    """Identify frames at random attitudes."""
    solver = Ours()
    solver.build(view, view.camera)
    seen = frames(view, _CELL, WARM_UP + trials, seed)
    attitudes, cpu_s = timed_attitudes(solver, seen)
    truths = [frame.truth for frame in seen[WARM_UP:]]
    return Outcome(np.array([kind_of(*pair) for pair in zip(attitudes, truths)]), cpu_s)


def measure_build(view: View) -> tuple[float, float]:
    """Return the wall time in s and the resident memory in MB of a database, without a cache."""
    solver, process = Ours(), psutil.Process()
    solver.build(WARM_UP_VIEW, WARM_UP_VIEW.camera)
    # What was freed but not returned to the system would be used again.
    return_freed = ctypes.CDLL('libc.so.6').malloc_trim
    return_freed(0)
    with tempfile.TemporaryDirectory() as folder:
        os.environ['XDG_CACHE_HOME'] = folder
        before = process.memory_info().rss
        start_s = time.perf_counter()
        solver.build(view, view.camera)
        build_s = time.perf_counter() - start_s
    return_freed(0)
    return build_s, (process.memory_info().rss - before) / 1e6


def narrow_field_rows(*, trials: int, seed: int, scheduler: str = '') -> Iterator[Row]:
    """Yield the figures of each camera: identified, wrong, times, cost of the database."""
    views = list(VIEWS.values())
    done = parallel_trials(solve_frames, [(view,) for view in views], trials, _PART_TRIALS, seed,
                           title='narrow fields', scheduler=scheduler)
    for view, outcome in zip(views, done):
        solved = 100 * float(np.mean(outcome.kind == CORRECT))
        least = _SOLVED_PERCENT[view.name]
        yield Row(f'{view.name}: correct', solved, '%', least=least)
        wrong = int(np.count_nonzero(outcome.kind == WRONG))
        yield Row(f'{view.name}: wrong', wrong, 'frames', exactly=0)
        for name, percentile, most in (('median', 50, 2.0), ('p99', 99, 50.0)):
            time_ms = 1e3 * float(np.percentile(outcome.cpu_s, percentile))
            yield Row(f'{view.name}: time, {name}', time_ms, 'ms', most=most)
        with Processes(1) as fresh:
            build_s, memory_mb = fresh.submit(measure_build, view).result()
        yield Row(f'{view.name}: database, time', build_s, 's', most=3)
        yield Row(f'{view.name}: database, memory', memory_mb, 'MB', most=100)
