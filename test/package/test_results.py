# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of measured figures are those of the kept results; which results are outdated."""

import json
from pathlib import Path
import re
import shutil
import subprocess
import warnings

from limits import HANGS_S
import pytest
from startracker_evaluation import documents
from startracker_evaluation.campaign.papers import CAMPAIGNS, PAGE, PICTURES, write_page
from startracker_ros.tools.figures.machine import origin

ROOT = Path(__file__).parents[2]
RESULTS = sorted((ROOT / 'docs' / 'results').glob('*.json'))


@pytest.mark.parametrize('page', documents.pages(ROOT), ids=lambda page: page.name)
def test_tables_of_a_page_are_those_of_the_results(page):
    assert page.read_text() == documents.rendered(page, ROOT), (
        'run python -m startracker_evaluation.documents')


def test_the_page_of_the_papers_is_that_of_the_results(tmp_path):
    shutil.copytree(ROOT / 'docs' / 'results', tmp_path / 'results')
    shutil.copytree(ROOT / 'docs' / PICTURES, tmp_path / PICTURES)
    write_page(tmp_path)
    assert (tmp_path / PAGE).read_text() == (ROOT / 'docs' / PAGE).read_text()


def test_every_result_is_shown_and_says_where_it_is_from():
    shown = set(re.findall(r'<!-- result ([\w-]+)', '\n'.join(
        page.read_text() for page in documents.pages(ROOT))))
    assert {path.stem for path in RESULTS} == shown | set(CAMPAIGNS)
    for path in RESULTS:
        document = json.loads(path.read_text())
        assert document['rows'] and document['conditions'] is not None
        assert all(document[name] for name in ('commit', 'machine', 'date', 'code')), path


def test_results_older_than_the_code_are_named():
    # They hold until the command that measures them, which may take hours, has run again.
    for line in documents.outdated(ROOT):
        warnings.warn(line, stacklevel=1)


def test_a_result_is_outdated_by_a_commit_to_the_code_that_it_measures(tmp_path):
    def git(*arguments):
        return subprocess.run(
            ['git', '-c', 'user.name=t', '-c', 'user.email=t@example.org', *arguments],
            cwd=tmp_path, check=True, capture_output=True, text=True, timeout=HANGS_S).stdout

    def commit(path):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(path)
        git('add', path)
        git('commit', '-q', '-m', path)

    git('init', '-q')
    commit('startracker_ros/core/track/filter.py')
    document = {'commit': git('rev-parse', 'HEAD').strip() + '+',
                'code': ['core/track', 'evaluation/bench/a.py']}
    (tmp_path / 'docs/results').mkdir(parents=True)
    (tmp_path / 'docs/results/a.json').write_text(json.dumps(document))
    commit('startracker_ros/core/attitude/solver.py')
    assert [*documents.outdated(tmp_path)] == []
    commit('evaluation/startracker_evaluation/bench/a.py')
    assert [*documents.outdated(tmp_path)] == [
        'a.json: 1 commits older than what it measures']
    (tmp_path / 'docs/results/a.json').write_text(json.dumps({**document, 'commit': 'abcdef0'}))
    assert [*documents.outdated(tmp_path)] == ['a.json: commit abcdef0 is not known here']


def test_an_excerpt_has_the_named_columns_and_rows_and_no_conditions(tmp_path):
    (tmp_path / 'docs/results').mkdir(parents=True)
    (tmp_path / 'docs/results/a.json').write_text(json.dumps({
        'rows': [{'case': '1 px: error', 'ours': 1.5, 'bound': '< 2', 'holds': True},
                 {'case': '2 px: error', 'ours': 2.5, 'bound': '', 'holds': True}],
        'conditions': {'seed': 1, 'stars': 'many'}, 'commit': 'abc', 'machine': 'm', 'date': 'd'}))
    page = tmp_path / 'README.md'
    page.write_text('a\n<!-- result a -->\nearlier\n<!-- end of result -->\nb\n'
                    '<!-- result a: case, ours: ^2 px -->\n<!-- end of result -->\n')
    whole, excerpt = documents.rendered(page, tmp_path).split('b\n')
    assert whole.splitlines()[3:7] == ['| case | ours | bound | holds |', '|---|---|---|---|',
                                       '| 1 px: error | 1.5 | &lt; 2 | yes |',
                                       '| 2 px: error | 2.5 |  | - |']
    assert '[a.json](docs/results/a.json): d, commit abc, seed 1; m' in whole
    assert '| stars | many |' in whole and 'earlier' not in whole
    assert '| 2 px: error | 2.5 |' in excerpt and 'bound' not in excerpt
    assert '1 px' not in excerpt and 'stars' not in excerpt


def test_what_several_solvers_reach_stands_side_by_side(tmp_path):
    (tmp_path / 'docs/results').mkdir(parents=True)
    (tmp_path / 'docs/results/a.json').write_text(json.dumps({
        'rows': [{'cell': cell, 'solver': solver, 'right': right, 'ms': None}
                 for cell, solver, right in (('1 px', 'ours', 3), ('1 px', 'peer', 2),
                                             ('2 px', 'ours', 1))],
        'conditions': {}, 'commit': 'abc', 'machine': 'm', 'date': 'd'}))
    page = tmp_path / 'README.md'
    page.write_text('<!-- result a: cell, right / ms of each solver -->\n<!-- end of result -->\n')
    assert documents.rendered(page, tmp_path).splitlines()[2:6] == [
        '| cell | ours | peer |', '|---|---|---|', '| 1 px | 3 / - | 2 / - |',
        '| 2 px | 1 / - | - |']


def test_the_origin_of_a_result_names_the_code_that_was_loaded():
    code = origin()['code']
    assert {'evaluation/campaign/papers.py', 'core/maths'} <= set(code)
    assert not any(path.startswith(('io', 'tools/cli')) for path in code)
