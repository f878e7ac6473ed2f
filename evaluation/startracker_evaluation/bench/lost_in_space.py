# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ours, tetra3rs and cedar-solve on the same star lists: correct, wrong, time, database."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
import tempfile

import numpy as np
from startracker_evaluation.bench.corpus import ALL_CELLS, Cell, frames, View, VIEWS
from startracker_evaluation.bench.peers import (
    CEDAR, Cedar, Database, measure_database, Solver, solvers, timed_attitudes, TUNED, WARM_UP)
from startracker_evaluation.extras import peer_versions
from startracker_ros.io.table import Result
from startracker_ros.io.workers import Processes
from startracker_ros.tools.figures.correctness import CORRECT_TEXT, is_correct
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Check, combined
from startracker_ros.tools.parallel import parallel_trials

DATABASE = 'database'
"""The name in --only of the building of the databases."""

_PART_TRIALS = 250
UNSOLVED, CORRECT, WRONG = range(3)
# Of correct frames in the hardest cells, in percent.
_LEAST_CORRECT = {('A12', ALL_CELLS['1px-20missing-10false']): 88,
                  ('A12', ALL_CELLS['1px-20missing-20false']): 88}


@dataclass(frozen=True)
class Outcome:
    """Results of a solver: UNSOLVED, CORRECT or WRONG (N,), and process CPU times (N,) in s."""

    kind: np.ndarray
    cpu_s: np.ndarray

    @property
    def figures(self) -> dict[str, float]:
        """Return the columns of a row."""
        return {'correct_percent': 100 * float(np.mean(self.kind == CORRECT)),
                'wrong_percent': 100 * float(np.mean(self.kind == WRONG)),
                'median_ms': 1e3 * float(np.median(self.cpu_s)),
                'p99_ms': 1e3 * float(np.percentile(self.cpu_s, 99))}


def kind_of(attitude: np.ndarray | None, truth: np.ndarray | None) -> int:
    """Return UNSOLVED, CORRECT or WRONG; without a true attitude (4,) every solution is wrong."""
    if attitude is None:
        return UNSOLVED
    return CORRECT if truth is not None and is_correct(attitude, truth) else WRONG


def solve_frames(view: View, cell: Cell, cedar: Cedar | None, trials: int, seed: int
                 ) -> dict[str, Outcome]:
    """Run one solver after another on the same frames, so that all have the same load."""
    seen = frames(view, cell, WARM_UP + trials, seed)
    runs = {name: timed_attitudes(solver, seen)
            for name, solver in _built_solvers(
                view, cell.focal_ratio, cell.fov_error_percent).items()}
    if cedar is not None:
        camera = view.camera.with_focal_ratio(1 / cell.focal_ratio)
        runs[CEDAR] = cedar.timed_attitudes(view, camera, seen)
    truths = [frame.truth for frame in seen[WARM_UP:]]
    return {name: Outcome(np.array([kind_of(*pair) for pair in zip(attitudes, truths)]), cpu_s)
            for name, (attitudes, cpu_s) in runs.items()}


@lru_cache(maxsize=8)
def _built_solvers(view: View, focal_ratio: float, fov_error_percent: float
                   ) -> dict[str, Solver]:
    """Return the solvers of a view, built once in each process."""
    built = solvers()
    for solver in built.values():
        solver.build(view, view.camera.with_focal_ratio(1 / focal_ratio), fov_error_percent)
    return built


@dataclass(frozen=True)
class SolverRow:
    """One solver in one cell, or the cost of its database."""

    cell: str
    camera: str
    solver: str
    correct_percent: float | None = None
    wrong_percent: float | None = None
    median_ms: float | None = None
    p99_ms: float | None = None
    build_s: float | None = None
    file_mb: float | None = None
    memory_mb: float | None = None
    bound: str = ''
    holds: bool = True


def cell_rows(view: View, name: str, cell: Cell, outcomes: Mapping[str, Outcome]
              ) -> Iterator[SolverRow]:
    """Yield a row of each solver, that of ours with its bounds."""
    figures = {solver: outcome.figures for solver, outcome in outcomes.items()}
    for solver, own in figures.items():
        bound, holds = combined(bounds(view, cell, figures) if solver == 'ours' else [])
        solvable = cell.sky not in ('none', 'mirrored')
        yield SolverRow(name, view.name, solver, own['correct_percent'] if solvable else None,
                        own['wrong_percent'], own['median_ms'], own['p99_ms'],
                        bound=bound, holds=holds)


def bounds(view: View, cell: Cell, figures: Mapping[str, Mapping[str, float]]) -> list[Check]:
    """Return the bounds of ours in a cell."""
    ours = figures['ours']
    peers = {name: own for name, own in figures.items() if name != 'ours'}
    checks = [('wrong = 0', ours['wrong_percent'] == 0)]
    if cell.sky in ('none', 'mirrored'):
        # A list that cannot be identified stalls what waits for it.
        return [*checks, ('p99 <= 30', ours['p99_ms'] <= 30)]
    if cell.focal_ratio != 1:
        return [*checks, ('correct >= 99', ours['correct_percent'] >= 99),
                ('median <= 1', ours['median_ms'] <= 1)]
    if peers:
        name, best = max(peers.items(), key=lambda peer: peer[1]['correct_percent'])
        checks.append((f'correct >= {best["correct_percent"]:.4g} ({name})',
                       ours['correct_percent'] >= best['correct_percent']))
    if (view.name, cell) in _LEAST_CORRECT:
        least = _LEAST_CORRECT[view.name, cell]
        checks.append((f'correct >= {least:g}', ours['correct_percent'] >= least))
    tuned = [peers[name]['median_ms'] for name in TUNED if name in peers]
    if tuned and not cell.missing and not cell.false:
        checks.append((f'median <= {min(tuned):.3g} (tetra3rs tuned)',
                       ours['median_ms'] <= min(tuned)))
    if cell.false == 10 and not cell.missing:
        checks.append(('p99 <= 5', ours['p99_ms'] <= 5))
    return checks


def databases(views: Sequence[View], cedar: Cedar | None) -> Iterator[tuple[View, str, Database]]:
    """Yield the cost of each database, built in a new process."""
    for view in views:
        for solver in solvers():
            with Processes(1) as fresh:
                yield view, solver, fresh.submit(measure_database, solver, view).result()
        if cedar is not None:
            yield view, CEDAR, cedar.build(view)


def database_row(view: View, solver: str, database: Database) -> SolverRow:
    """Return the cost of a database; ours has to be built within a second."""
    bound, holds = combined(
        [('build <= 1 s', database.seconds <= 1)] if solver == 'ours' else [])
    return SolverRow(DATABASE, view.name, solver, build_s=database.seconds,
                     file_mb=database.file_mb, memory_mb=database.memory_mb, bound=bound,
                     holds=holds)


def run_lost_in_space_bench(*, trials: int, seed: int, only: Sequence[str],
                            cameras: Sequence[str] = tuple(VIEWS), cedar_python: str = '',
                            scheduler: str = '') -> Result:
    """Run the named cells, and the databases, for the named cameras."""
    views = [VIEWS[name] for name in cameras]
    names = [name for name in only if name != DATABASE]
    with tempfile.TemporaryDirectory() as folder:
        cedar = Cedar(cedar_python, folder) if cedar_python else None
        versions = _versions(cedar)
        rows: list[SolverRow] = []
        if DATABASE in only or cedar is not None:
            rows = [database_row(*built) for built in databases(views, cedar)]
        cells = [(view, name) for name in names for view in views]
        done = parallel_trials(
            solve_frames, [(view, ALL_CELLS[name], cedar) for view, name in cells], trials,
            _PART_TRIALS, seed, title='lost in space', scheduler=scheduler)
    for (view, name), outcomes in zip(cells, done):
        rows += cell_rows(view, name, ALL_CELLS[name], outcomes)
    return Result('bench lost-in-space', _used_columns(rows), {
        'machine': machine(),
        'cameras': '; '.join(f'{view.name}: {view.fov_deg:g} deg, {view.width} px, V '
                             f'{view.magnitude_limit:g}' for view in views),
        'correct': f'{CORRECT_TEXT}; wrong: any other solution',
        'times': 'process CPU time of the solve call, garbage collector off, after '
                 f'{WARM_UP} frames; build_s is wall time in a fresh process',
        'memory_mb': 'growth of the resident memory to its peak while building',
        **versions, 'trials': trials, 'seed': seed})


def _used_columns(rows: Sequence[SolverRow]) -> list[dict[str, object]]:
    """Return the rows without the columns that none of them has."""
    names = [column.name for column in fields(SolverRow)]
    used = [name for name in names if any(getattr(row, name) is not None for row in rows)]
    return [{name: getattr(row, name) for name in used} for row in rows]


def _versions(cedar: Cedar | None) -> dict[str, str]:
    return {**peer_versions('tetra3rs'),
            CEDAR: cedar.version() if cedar else 'absent: --cedar-python names its venv'}
