# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command line: wrong use, bench rows, what is promised of README."""

from importlib.metadata import EntryPoints
import json
from pathlib import Path
import re

from commands import invoke
import pytest

ROOT = Path(__file__).parents[1]


def startracker(*arguments):
    """Run the command in this process; it ends by itself, not by an exception."""
    done = invoke(*arguments)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    return done


def test_the_two_commands_stand_in_the_first_screen():
    first_screen = (ROOT / 'README.md').read_text().splitlines()[:40]
    assert any('make demo' in line for line in first_screen)
    assert any('make test' in line for line in first_screen)
    makefile = (ROOT / 'Makefile').read_text()
    assert re.search('^demo:', makefile, re.MULTILINE)
    assert re.search('^test:', makefile, re.MULTILINE)
    assert 'make test' in (ROOT / '.ci' / 'run').read_text()


@pytest.mark.parametrize('name, arguments', [
    ('campaign', ['campaign', 'jpdaf']), ('bench', ['bench', 'jpda', '--trials', '1']),
    ('closed-loop', ['demo', 'closed-loop'])])
def test_a_command_of_evaluation_says_what_to_install(name, arguments, monkeypatch):
    monkeypatch.setattr('importlib.metadata.entry_points', lambda group: EntryPoints())
    done = startracker(*arguments)
    assert done.exit_code == 1
    assert done.stderr == (
        f'startracker: {name} is a command of startracker-evaluation, which is not installed: '
        'pip install ./evaluation in a clone\n')
    help_page = startracker('--help')
    assert help_page.exit_code == 0 and 'campaign' not in help_page.stdout


@pytest.mark.parametrize('arguments, words', [
    (['fly'], "No such command 'fly'"),
    (['run', 'rocket'], "no node 'rocket'; there are sky_simulator"),
    (['solve', 'a.png', '--fov-deg', '10', '--camera', __file__],
     'give either --fov-deg or --camera'),
    (['solve', 'a.png', '--fov-deg', '400'], '400'),
    (['calibrate', 'a.png', '-o', 'c.yaml', '--fov-deg', '10', '--site', '48', '11', '500'],
     'need --epoch'),
    (['solve', 'a.png', '--fov-deg', '10', '--epoch', 'noon'], "'noon' is neither a year nor"),
    (['solve', 'a.png', '--fov-deg', '10', '--epoch', '2026.5', '--site', '98', '11', '500'],
     'no latitude, longitude and height'),
    (['solve', 'a.png', '--fov-deg', '10', '--epoch', '2026.5', '--velocity', '0', '21', '0'],
     'more than 20 km/s about the Earth'),
    (['calibrate', 'a.png', '-o', 'c.yaml', '--fov-deg', '10', '--epoch', '2026.5', '--site',
      '48', '11', '500', '--velocity', '0', '7', '0'], 'give either --site or --velocity'),
    (['bench', 'pipeline', '--only', 'speed'], 'no case speed; there are noise-free'),
    (['demo', '--seconds', '1'], '5'),
])
def test_wrong_use_is_status_2(arguments, words):
    done = startracker(*arguments)
    assert done.exit_code == 2
    assert words in done.stderr


@pytest.mark.parametrize('options, condition', [
    ([], 'none (no --epoch)'), (['--epoch', '2150.0'], 'none (epoch J2150.00 is outside'),
    (['--epoch', '2026-11-23T01:30'], 'earth_only'),
    (['--epoch', '2026-11-23T01:30', '--velocity', '0', '7.5', '0'], 'full'),
    (['--epoch', '2026-11-23T02:30+01:00', '--site', '48', '11.5', '500'], 'full')])
def test_the_correction_of_aberration_is_in_the_result(tmp_path, options, condition):
    (tmp_path / 'notes.png').write_text('not an image')
    done = startracker('solve', '--fov-deg', '11.4', '--json', str(tmp_path / 'notes.png'),
                       *options)
    conditions = json.loads(done.stdout)['conditions']
    assert conditions['aberration'].startswith(condition)
    if 'T' in ''.join(options):
        assert conditions['epoch'] == pytest.approx(2026.8937, abs=1e-3)


def test_unreadable_image_is_a_row_and_status_1(tmp_path):
    (tmp_path / 'notes.png').write_text('not an image')
    done = startracker('solve', '--fov-deg', '11.4', '--json', str(tmp_path / 'notes.png'))
    assert done.exit_code == 1
    row, = json.loads(done.stdout)['rows']
    assert not row['solved'] and 'notes.png' in row['file']


@pytest.mark.slow
def test_bench_prints_rows_that_hold():
    """Except times, which are those of the machine."""
    done = startracker('bench', 'pipeline', '--json', '--trials', '100', '--only', 'cramer-rao',
                       '--only', 'database')
    document = json.loads(done.stdout)
    rows = document['rows']
    assert done.exit_code == (0 if all(row['holds'] for row in rows) else 1)
    assert all(row['holds'] for row in rows if row['unit'] not in ('s', 'ms')), document
    assert {'case', 'ours', 'peer', 'ratio', 'unit'} <= set(rows[0])
    assert document['conditions']['trials'] == 100
