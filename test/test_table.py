# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables at the width of a terminal: columns by width, remarks below them, no word broken."""

import json
import re

import click
from click.testing import CliRunner
import pytest
from startracker_evaluation.campaign.integrity import IntegrityRow
from startracker_ros.io.table import Result, show
from startracker_ros.tools.cli.photographs import solve
from startracker_ros.tools.cli.shared import finish, json_option

REASON = ('no hypothesis has a false-alarm probability below 1e-06: the best one matches 3 of 14 '
          'stars, which chance alone does in one field of 40; a wrong field of view or clouds '
          'would explain it')
SOLVED = {'file': '2019-07-29T204726_Alt40_Azi-135_Try1.png', 'solved': True, 'ra_deg': 230.6697,
          'dec_deg': 11.0383, 'roll_deg': 27.7158, 'fov_deg': 11.429, 'residual_arcsec': 3.652,
          'matched': 9, 'solve_ms': 56.65, 'reason': ''}
UNSOLVED = {**SOLVED, 'solved': False, **dict.fromkeys(
    ('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg', 'residual_arcsec'), None), 'reason': REASON}
INTEGRITY = IntegrityRow('lit by the limb of the Earth, slow slew', 6000, 99.6,
                         '0 wrong, >= 95 % published', 0, 0, 0.0005, 4.2, 3.01, 3.1, 2.8, 3, 2.9,
                         4, 2.5, 0.62, 2, True)
RESULTS = [Result('solve', [SOLVED, UNSOLVED], {'epoch': 2026.5}),
           Result('campaign integrity', [INTEGRITY, INTEGRITY], {'camera': '1024 x 1024 px'})]


def printed(capsys, monkeypatch, result, columns=None, wide=False):
    """Return the lines that a terminal of that many columns shows, or that a pipe receives."""
    monkeypatch.delenv('COLUMNS', raising=False)
    monkeypatch.delenv('FORCE_COLOR', raising=False)
    if columns:
        monkeypatch.setenv('FORCE_COLOR', '1')
        monkeypatch.setenv('COLUMNS', str(columns))
    show(result, as_json=False, wide=wide)
    return re.sub(r'\x1b\[[0-9;]*m', '', capsys.readouterr().out).splitlines()


def table_of(lines):
    return [line for line in lines if line[:1] in '┏┃┡│└']


def words_of(lines):
    return {word for line in lines for word in re.findall(r'[^\s┃│┏┓┡┩└┘━─┳╇┴]+', line)}


@pytest.mark.parametrize('result', RESULTS, ids=lambda result: result.name)
@pytest.mark.parametrize('columns', [80, 100, 132])
def test_a_terminal_gets_the_columns_that_fit(capsys, monkeypatch, result, columns):
    lines = printed(capsys, monkeypatch, result, columns)
    table = table_of(lines)
    assert len({len(line) for line in table}) == 1
    assert max(map(len, lines)) <= columns
    for record in result.records:
        # The first column, and every word of the remark below the table.
        remark = '' if record.get('solved') else record.get('reason') or record['bound']
        first = str(next(iter(record.values())))
        assert {*first.split(), *remark.split()} <= words_of(lines)
    hidden = re.search('not shown: (.*?); +all', ' '.join(lines))
    hidden = hidden[1] if hidden else ''
    shown = [name for name in result.records[0] if not re.search(rf'\b{name}\b', hidden)]
    # Headers may be broken, between words only.
    pieces = words_of(table)
    assert all(name in pieces or set(name.replace('_', ' ').split()) <= pieces
               or any(f': {name}:' in line for line in lines) for name in shown)
    assert (len(shown) < len(result.records[0])) == bool(hidden)


def test_a_long_reason_is_below_the_table_under_the_name_of_its_row(capsys, monkeypatch):
    lines = printed(capsys, monkeypatch, RESULTS[0], 80)
    table = table_of(lines)
    assert len(table) == 6 and 'hypothesis' not in words_of(table)
    below = lines[lines.index(table[-1]) + 1:]
    assert below[0].strip().startswith(f'{UNSOLVED["file"]}: reason: no hypothesis has')
    assert REASON in ' '.join(line.strip() for line in below)
    assert [line for line in lines if 'reason:' in line] == below[:1]


def test_rows_of_remarks_are_paragraphs(capsys, monkeypatch):
    rows = [{'name': 'min_stars', 'range': '2 .. 100', 'meaning': REASON, 'note': REASON},
            {'name': 'solver', 'range': 'one of quest, davenport, svd', 'meaning': '', 'note': ''}]
    lines = printed(capsys, monkeypatch, Result('parameters', rows), 80)
    assert table_of(lines) == []
    assert lines[1:3] == ['min_stars', '  range 2 .. 100  meaning no hypothesis has a false-alarm '
                          'probability below'[:78].rstrip()]


def test_headers_are_whole_where_there_is_space(capsys, monkeypatch):
    lines = table_of(printed(capsys, monkeypatch, Result('x', [
        {'case': 'a', 'residual_arcsec': 1.0, 'remark': REASON}]), 80))
    assert 'residual_arcsec' in words_of(lines) and 'remark' not in words_of(lines)
    narrow = table_of(printed(capsys, monkeypatch, RESULTS[0], 100))
    assert {'roll', 'deg'} <= words_of(narrow)
    assert not any(word.endswith('_') for word in words_of(narrow))


def test_whether_a_row_holds_is_never_left_out(capsys, monkeypatch):
    lines = printed(capsys, monkeypatch, RESULTS[1], 80)
    assert 'holds' in words_of(table_of(lines)) and 'yes' in words_of(lines)
    assert any('not shown: ' in line for line in lines)


@pytest.mark.parametrize('result', RESULTS, ids=lambda result: result.name)
@pytest.mark.parametrize('columns', [40, 60])
def test_a_narrow_terminal_gets_all_figures_as_paragraphs(capsys, monkeypatch, result, columns):
    lines = printed(capsys, monkeypatch, result, columns)
    assert max(map(len, lines)) <= columns and table_of(lines) == []
    text = ' '.join(line.strip() for line in lines)
    for record in result.records:
        (_, first), *others = record.items()
        assert first in text
        assert all(re.search(rf'\b{name}:? ', text) for name, _ in others)


def test_what_says_nothing_is_not_shown(capsys, monkeypatch):
    result = Result('x', [{'case': 'a', 'bound': '', 'holds': True},
                          {'case': 'b', 'bound': '< 1', 'holds': True}])
    lines = table_of(printed(capsys, monkeypatch, result, 80))
    assert lines[3].split()[-2] == '-' and lines[4].split()[-2] == 'yes'
    assert result.records[0]['holds'] is True
    solved = table_of(printed(capsys, monkeypatch, Result('solve', [SOLVED]), 80))
    assert not any('9 stars' in line for line in solved)


def test_conditions_have_their_units(capsys, monkeypatch):
    result = Result('x', [{'case': 'a'}], {'focal': 5113.88}, notes={'focal': 'px'})
    assert printed(capsys, monkeypatch, result, 80)[-1] == '  focal: 5113.88 px'


@pytest.mark.parametrize('columns', [None, 80])
@pytest.mark.parametrize('result', RESULTS, ids=lambda result: result.name)
def test_a_file_or_wide_gets_all_columns(capsys, monkeypatch, result, columns):
    lines = printed(capsys, monkeypatch, result, columns, wide=columns is not None)
    assert not any('not shown' in line for line in lines)
    text = ' '.join(lines)
    assert all(name in text or all(piece in text for piece in name.replace('_', ' ').split())
               for name in result.records[0])
    assert len({len(line) for line in table_of(lines)}) == 1


def test_a_table_that_fits_has_one_line_for_each_row(capsys, monkeypatch):
    result = Result('x', [{'case': 'a', 'note': REASON[:40], 'holds': True}])
    assert len(table_of(printed(capsys, monkeypatch, result, 80))) == 5
    assert table_of(printed(capsys, monkeypatch, Result('empty', []), 80)) == []


def test_a_word_longer_than_the_terminal_is_whole(capsys, monkeypatch):
    path = '/data/' + 90 * 'x' + '.png'
    assert path in words_of(printed(capsys, monkeypatch, Result('x', [{
        'file': path, 'solved': False, 'reason': f'{path}: is not an image'}]), 60))


def test_the_option_wide_reaches_the_table(monkeypatch):
    @click.command()
    @json_option
    def command(as_json):
        finish(RESULTS[1], as_json)
    monkeypatch.setenv('FORCE_COLOR', '1')
    monkeypatch.setenv('COLUMNS', '80')
    run = CliRunner().invoke
    assert 'not shown' in run(command).output
    assert 'not shown' not in run(command, ['--wide']).output
    assert json.loads(run(command, ['--json', '--wide']).output)['rows'] == RESULTS[1].records
    assert any('--wide' in parameter.opts for parameter in solve.params)
