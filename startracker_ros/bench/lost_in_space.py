"""The same star lists through ours, tetra3rs and cedar-solve: right, wrong, time, database."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
import multiprocessing
import os
import platform
import tempfile

import numpy as np
from startracker_ros.bench.corpus import ALL_CELLS, Cell, Frame, frames, View, VIEWS
from startracker_ros.bench.peers import (
    CEDAR, Cedar, Database, measure_database, peer_version, race, Solver, solvers, TUNED, WARM_UP)
from startracker_ros.campaign.parallel import parallel_map, split
from startracker_ros.maths.rotation import attitude_error
from startracker_ros.table import Result

DATABASE = 'database'
"""What --only calls the building of the databases."""

_PIECE = 250
_COLUMNS = ('cell', 'camera', 'solver', 'correct_percent', 'wrong_percent', 'median_ms', 'p99_ms',
            'build_s', 'file_mb', 'memory_mb', 'bound', 'holds')
_NO_ANSWER, _CORRECT, _WRONG = range(3)

# Answers (N,) of the kinds above, and CPU times (N,) in s, by solver.
Outcome = Mapping[str, tuple[np.ndarray, np.ndarray]]
Row = dict[str, object]
Check = tuple[str, bool]


def judge(attitude: np.ndarray | None, truth: np.ndarray | None) -> int:
    """Return whether an answer (4,) is correct: 0.05 deg cross-boresight, 0.5 deg of roll."""
    if attitude is None:
        return _NO_ANSWER
    if truth is None:
        return _WRONG
    x, y, roll = np.degrees(attitude_error(attitude, truth))
    return _CORRECT if np.hypot(x, y) < 0.05 and abs(roll) < 0.5 else _WRONG


def piece(view: View, cell: Cell, trials: int, seed: int, cedar: Cedar | None) -> Outcome:
    """Send the same frames through one solver after another, so that all see the same load."""
    shown = frames(view, cell, WARM_UP + trials, seed)
    runs = {name: race(solver, shown)
            for name, solver in _ready(view, cell.focal_ratio).items()}
    if cedar is not None:
        camera = view.camera.with_focal_ratio(1 / cell.focal_ratio)
        runs[CEDAR] = cedar.race(view, camera, shown)
    return {name: (_judged(attitudes, shown[WARM_UP:]), cpu_s)
            for name, (attitudes, cpu_s) in runs.items()}


@lru_cache(maxsize=8)
def _ready(view: View, focal_ratio: float) -> dict[str, Solver]:
    """Return the solvers of a view, built once in each process."""
    ready = solvers()
    for solver in ready.values():
        solver.build(view, view.camera.with_focal_ratio(1 / focal_ratio))
    return ready


def _judged(attitudes: Sequence[np.ndarray | None], shown: Sequence[Frame]) -> np.ndarray:
    return np.array([judge(attitude, frame.truth) for attitude, frame in zip(attitudes, shown)])


def cell_rows(view: View, name: str, cell: Cell, outcome: Outcome) -> Iterator[Row]:
    """Yield a row of each solver; that of ours is held against its bounds."""
    figures = {solver: _figures(*run) for solver, run in outcome.items()}
    for solver, own in figures.items():
        shown: dict[str, float | None] = {**own}
        if cell.sky in ('none', 'mirrored'):
            shown = {**own, 'correct_percent': None}
        checks = bounds(view, cell, figures) if solver == 'ours' else []
        yield _row(name, view, solver, checks, **shown)


def _figures(answers: np.ndarray, cpu_s: np.ndarray) -> dict[str, float]:
    return {'correct_percent': 100 * float(np.mean(answers == _CORRECT)),
            'wrong_percent': 100 * float(np.mean(answers == _WRONG)),
            'median_ms': 1e3 * float(np.median(cpu_s)),
            'p99_ms': 1e3 * float(np.percentile(cpu_s, 99))}


def bounds(view: View, cell: Cell, figures: Mapping[str, Mapping[str, float]]) -> list[Check]:
    """Return what ours is held against in a cell, and whether it holds."""
    ours = figures['ours']
    peers = {name: own for name, own in figures.items() if name != 'ours'}
    checks = [('wrong = 0', ours['wrong_percent'] == 0)]
    if cell.sky != 'any':
        return checks
    if peers:
        name, best = max(peers.items(), key=lambda peer: peer[1]['correct_percent'])
        checks.append((f'correct >= {best["correct_percent"]:.4g} ({name})',
                       ours['correct_percent'] >= best['correct_percent']))
    if (view.name, cell) == ('A12', ALL_CELLS['1px-20missing-10false']):
        checks.append(('correct >= 88', ours['correct_percent'] >= 88))
    tuned = [peers[name]['median_ms'] for name in TUNED if name in peers]
    if tuned and not cell.missing and not cell.false:
        checks.append((f'median <= {min(tuned):.3g} (tetra3rs tuned)',
                       ours['median_ms'] <= min(tuned)))
    if cell.false == 10 and not cell.missing:
        checks.append(('p99 <= 5', ours['p99_ms'] <= 5))
    return checks


def _row(cell: str, view: View, solver: str, checks: Sequence[Check], **figures: object) -> Row:
    named = {'cell': cell, 'camera': view.name, 'solver': solver, **figures,
             'bound': '; '.join(text for text, _ in checks),
             'holds': all(holds for _, holds in checks)}
    return {column: named.get(column) for column in _COLUMNS}


def databases(views: Sequence[View], cedar: Cedar | None) -> Iterator[tuple[View, str, Database]]:
    """Yield what each database takes, built in a process that has done nothing else."""
    spawn = multiprocessing.get_context('spawn')
    for view in views:
        for solver in solvers():
            with ProcessPoolExecutor(1, mp_context=spawn) as fresh:
                yield view, solver, fresh.submit(measure_database, solver, view).result()
        if cedar is not None:
            yield view, CEDAR, cedar.build(view)


def database_row(view: View, solver: str, database: Database) -> Row:
    """Return what a database takes; ours shall be built within a second."""
    checks = [('build <= 1 s', database.seconds <= 1)] if solver == 'ours' else []
    return _row(DATABASE, view, solver, checks, build_s=database.seconds,
                file_mb=database.file_mb, memory_mb=database.memory_mb)


def run_lost_in_space_bench(*, trials: int, seed: int, only: Sequence[str],
                            cameras: Sequence[str] = tuple(VIEWS), cedar_python: str = '',
                            scheduler: str = '') -> Result:
    """Run the named cells, and the databases, for the named cameras."""
    views = [VIEWS[name] for name in cameras]
    names = [name for name in only if name != DATABASE]
    with tempfile.TemporaryDirectory() as folder:
        cedar = Cedar(cedar_python, folder) if cedar_python else None
        versions = _versions(cedar)
        rows = []
        if DATABASE in only or cedar is not None:
            rows = [database_row(*built) for built in databases(views, cedar)]
        cells = [(view, ALL_CELLS[name]) for name in names for view in views]
        parts = split(trials, _PIECE, seed)
        outcomes = iter(parallel_map(
            piece, [(view, cell, *part, cedar) for view, cell in cells for part in parts],
            title='lost in space', scheduler=scheduler))
    for name in names:
        for view in views:
            pieces = [next(outcomes) for _ in parts]
            joined = {solver: (np.concatenate([run[solver][0] for run in pieces]),
                               np.concatenate([run[solver][1] for run in pieces]))
                      for solver in pieces[0]}
            rows += cell_rows(view, name, ALL_CELLS[name], joined)
    used = [column for column in _COLUMNS if any(row[column] is not None for row in rows)]
    return Result('bench lost-in-space', [{column: row[column] for column in used}
                                          for row in rows], {
        'machine': f'{platform.machine()}, {os.cpu_count()} cores, Python '
                   f'{platform.python_version()}, NumPy {np.__version__}',
        'cameras': '; '.join(f'{view.name}: {view.fov_deg:g} deg, {view.width} px, V '
                             f'{view.magnitude_limit:g}' for view in views),
        'correct': 'boresight within 0.05 deg, roll within 0.5 deg; wrong: any other answer',
        'times': 'process CPU time of the solve call, garbage collector off, after '
                 f'{WARM_UP} frames; build_s is wall time in a fresh process',
        'memory_mb': 'growth of the resident memory to its peak while building',
        **versions, 'trials': trials, 'seed': seed})


def _versions(cedar: Cedar | None) -> dict[str, str]:
    return {'tetra3rs': peer_version() or 'absent: pip install startracker_ros[bench]',
            CEDAR: cedar.version() if cedar else 'absent: --cedar-python names its venv'}
