# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The comparison with the peers: fair frames, correct adapters, bounds that can fail."""

import os
import subprocess
import sys

from commands import invoke
from limits import HANGS_S
import numpy as np
import pytest
from startracker_evaluation.bench.corpus import ALL_CELLS, Cell, CELLS, frames, View, VIEWS
from startracker_evaluation.bench.lost_in_space import (
    bounds, CORRECT, database_row, databases, kind_of, run_lost_in_space_bench, solve_frames,
    UNSOLVED, WRONG)
from startracker_evaluation.bench.peers import Cedar, Database, PeerError, solvers
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector

A12 = VIEWS['A12']
EASY = Cell(sigma_px=0.0)


def off(x_deg=0.0, y_deg=0.0, roll_deg=0.0):
    """Return an attitude off from the identity by angles about the sensor axes."""
    return quaternion_from_rotation_vector(np.radians([x_deg, y_deg, roll_deg]))


def test_the_same_seed_gives_the_same_frames():
    one, two, other = (frames(A12, CELLS['0.3px-20missing-10false'], 3, seed)
                       for seed in (1, 1, 2))
    for first, second, third in zip(one, two, other):
        np.testing.assert_array_equal(first.centroids.uv, second.centroids.uv)
        np.testing.assert_array_equal(first.truth, second.truth)
        assert not np.array_equal(first.truth, third.truth)
    assert not np.array_equal(frames(A12, EASY, 1, 1)[0].truth, one[0].truth)


def test_cells_are_one_factor_at_a_time_and_their_product():
    assert set(CELLS) < set(ALL_CELLS) and len(ALL_CELLS) == 48 + 4
    assert {'0.1px', '1px', '0.3px-5missing', '0.3px-20false', '1px-20missing-20false',
            'false-only', 'mirrored'} < set(CELLS)


def test_false_only_fields_have_as_many_stars_as_real_ones():
    real, false = ([len(frame.centroids) for frame in frames(A12, CELLS[name], 200, 1)]
                   for name in ('0.3px', 'false-only'))
    assert np.mean(false) == pytest.approx(np.mean(real), rel=0.1)
    assert all(frame.truth is None for frame in frames(A12, CELLS['mirrored'], 3, 1))


@pytest.mark.parametrize('view', [
    pytest.param(view, id=name, marks=() if name == 'B20' else pytest.mark.long)
    for name, view in VIEWS.items()])
def test_every_solver_solves_frames_without_noise(view):
    """One that does not has got the pixels, the field of view or the attitude wrong."""
    outcomes = solve_frames(view, EASY, None, 20, 1)
    assert list(outcomes) == ['ours', 'tetra3rs', 'tetra3rs 0.003', 'tetra3rs 0.005']
    for name, outcome in outcomes.items():
        assert np.mean(outcome.kind == CORRECT) >= 0.95, name
        assert not np.any(outcome.kind == WRONG), name
        assert outcome.cpu_s.shape == outcome.kind.shape == (20,) and np.all(outcome.cpu_s >= 0)


@pytest.fixture(scope='module')
def cedar_python(tmp_path_factory):
    """Return the Python of a venv of its own: cedar-solve wants a NumPy below 2."""
    folder = tmp_path_factory.mktemp('cedar')
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', str(folder)], check=True,
                   timeout=HANGS_S)
    python = str(folder / 'bin' / 'python')
    subprocess.run([sys.executable, '-m', 'pip', '--python', python, 'install', '-q',
                    '--no-compile', '--disable-pip-version-check', 'cedar-solve==0.5.1',
                    'numpy==1.26.4'], check=True, timeout=HANGS_S)
    return python


# The peer comes from the package index.
@pytest.mark.long
def test_cedar_solve_solves_frames_without_noise(cedar_python, tmp_path):
    cedar, wide = Cedar(cedar_python, str(tmp_path)), View('W40', 512, 40.0, 4.0)
    database = cedar.build(wide)
    assert database.seconds > 0 and database.file_mb > 0 and database.memory_mb > 0
    outcome = solve_frames(wide, EASY, cedar, 20, 1)['cedar-solve']
    assert np.all(outcome.kind == CORRECT) and np.all(outcome.cpu_s > 0)


def test_a_python_without_cedar_solve_is_an_error_with_the_remedy(tmp_path):
    with pytest.raises(PeerError, match='pip install cedar-solve'):
        Cedar(sys.executable, str(tmp_path)).version()


@pytest.mark.parametrize('attitude, truth, expected', [
    (off(), off(), CORRECT),
    (-off(0.03, 0.03, 0.45), off(), CORRECT),
    (off(0.04, 0.04), off(), WRONG),
    (off(roll_deg=-0.6), off(), WRONG),
    (multiply(off(30, 40, 50), off(0.01)), off(30, 40, 50), CORRECT),
    (off(), None, WRONG),
    (None, off(), UNSOLVED),
    (None, None, UNSOLVED),
])
def test_solutions_are_compared_with_the_truth(attitude, truth, expected):
    assert kind_of(attitude, truth) == expected


def figures(correct=100.0, wrong=0.0, median=0.05, p99=1.0):
    return {'correct_percent': correct, 'wrong_percent': wrong, 'median_ms': median,
            'p99_ms': p99}


@pytest.mark.parametrize('cell, ours, short', [
    ('0.3px', figures(), []),
    ('0.3px', figures(correct=98.9), ['correct >= 99 (tetra3rs)']),
    ('0.3px', figures(median=0.07), ['median <= 0.06 (tetra3rs tuned)']),
    ('0.3px', figures(p99=9.0), []),
    ('0.3px-20missing', figures(median=9.0), []),
    ('0.3px-10false', figures(median=9.0, p99=5.1), ['p99 <= 5']),
    ('0.3px-20false', figures(wrong=0.1), ['wrong = 0']),
    ('1px-20missing-10false', figures(correct=87.0), ['correct >= 99 (tetra3rs)',
                                                      'correct >= 88']),
    ('false-only', figures(correct=0.0, p99=900.0), ['p99 <= 30']),
    ('field-5-percent-off', figures(correct=98.0, median=1.1), ['correct >= 99', 'median <= 1']),
    ('false-only', figures(correct=0.0, wrong=0.1), ['wrong = 0']),
])
def test_bounds(cell, ours, short):
    run = {'ours': ours, 'tetra3rs': figures(correct=99.0, median=0.01),
           'tetra3rs 0.003': figures(correct=98.0, median=0.06)}
    assert [text for text, holds in bounds(A12, ALL_CELLS[cell], run) if not holds] == short


def test_without_peers_only_the_absolute_bounds_are_left():
    assert bounds(A12, CELLS['0.3px'], {'ours': figures()}) == [('wrong = 0', True)]


def test_rows_are_complete(one_process):
    result = run_lost_in_space_bench(trials=1, seed=1, only=('0.3px', 'mirrored'),
                                     cameras=('B20',))
    by_cell = {(row['cell'], row['solver']): row for row in result.rows}
    assert len(by_cell) == len(result.rows) == 2 * len(solvers())
    assert len({tuple(row) for row in result.rows}) == 1
    for (cell, solver), row in by_cell.items():
        assert row['camera'] == 'B20' and bool(row['bound']) == (solver == 'ours')
        assert row['p99_ms'] >= row['median_ms'] >= 0
        assert (row['correct_percent'] is None) == (cell == 'mirrored')
    assert result.conditions['tetra3rs'] == '0.14.0'
    assert 'absent' in result.conditions['cedar-solve']


def test_a_database_is_measured_in_a_process_of_its_own():
    before = dict(os.environ)
    measured = next(databases([A12], None))
    assert measured[:2] == (A12, 'ours') and before == dict(os.environ)
    row = database_row(*measured)
    assert row.build_s > 0 and row.file_mb > 0.1 and row.memory_mb > 1
    assert row.bound == 'build <= 1 s'
    assert not database_row(A12, 'ours', Database(1.1, 1, 1)).holds
    assert database_row(A12, 'tetra3rs', Database(1.1, 1, 1)).holds


@pytest.mark.parametrize('arguments, words', [
    (['--only', '7px'], 'no case 7px; there are database, 0.1px'),
    (['--camera', 'D1'], 'no camera D1; there are A12, B20, C10'),
    (['--cedar-python', sys.executable, '--scheduler', 'tcp://nowhere:1'], 'on this machine'),
])
def test_wrong_use_is_status_2(arguments, words):
    done = invoke('bench', 'lost-in-space', *arguments)
    assert done.exit_code == 2 and words in done.stderr
