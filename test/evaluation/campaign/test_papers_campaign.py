# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All papers on one page: results kept as data, the page made of them, states that follow."""

from collections import Counter
import json
import re

from commands import invoke
import pytest
from startracker_evaluation.campaign import papers
from startracker_evaluation.campaign.paper_claims import Claim, Paper, PAPERS
from startracker_ros.io.table import Result


def record(case, holds, bound=''):
    return {'case': case, 'paper': '> 1', 'as_published': 2.0, 'beyond': None, 'unit': 'px',
            'bound': bound, 'holds': holds, 'ours': 2.0}


PAPER = Paper('A paper', 'Somebody', ('quad',), ('first | row',), (
    Claim('table 1', 'a < b', '^first'), Claim('table 2', 'c', '^second'),
    Claim('table 3', 'd', '^third'), Claim('table 4', 'e', '^fourth'),
    Claim('table 5', 'f', '^fifth', state='better'), Claim('figure 1', 'g', picture='figure_1'),
    Claim('figure 2', 'h', picture='figure_2'),
    Claim('table 6', 'i', '^sixth', state='differs', why='reason'),
    Claim('table 7', 'j', state='cannot be', why='no data')))
ROWS = [record('first | row', True), record('second', False), record('second too', True),
        record('third', None, 'x >= 1: too few trials, 3 of 5'), record('fifth', True),
        record('sixth', None)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(papers, 'PAPERS', (PAPER,))
    (tmp_path / papers.RESULTS).mkdir()
    (tmp_path / papers.PICTURES / 'quad').mkdir(parents=True)
    (tmp_path / papers.PICTURES / 'quad' / 'figure_1_angles.png').touch()
    (tmp_path / papers.RESULTS / 'quad.json').write_text(json.dumps({
        'name': 'campaign quad', 'rows': ROWS, 'details': ['ours'], 'commit': 'abc',
        'machine': 'one', 'date': '2026-01-02T03:04:05+00:00',
        'conditions': {'orbit': 'round', 'trials': 3, 'seed': 1}}))
    return tmp_path


def test_the_state_of_a_claim_follows_from_its_rows_and_pictures(folder):
    rows = papers.write_page(folder)
    assert {row.item: (row.state, row.holds) for row in rows} == {
        'table 1': ('reproduced', True), 'table 2': ('does not hold', False),
        'table 3': ('too few trials', None), 'table 4': ('not run', None),
        'table 5': ('better', True), 'figure 1': ('reproduced', True),
        'figure 2': ('not run', None), 'table 6': ('differs', True),
        'table 7': ('cannot be', None)}
    assert [row.why for row in rows if row.why] == [
        'second', 'in 1 of 1 rows', 'no such row', 'no such picture', 'reason', 'no data']


def test_the_page_has_claims_rows_conditions_and_pictures(folder):
    papers.write_page(folder)
    page = (folder / papers.PAGE).read_text()
    assert '| table 1 | a &lt; b | reproduced |' in page
    assert '| first \\| row | > 1 | 2 | - | px |  | - |' in page
    assert 'commit abc, seed 1, trials 3' in page and '| orbit | round |' in page
    assert '![figure 1 angles](pictures/papers/quad/figure_1_angles.png)' in page
    header = next(line for line in page.splitlines() if line.startswith('| case'))
    assert header == '| case | paper | as_published | beyond | unit | bound | holds |'


def test_the_first_table_has_a_row_of_each_paper_with_the_figures_of_its_result(folder):
    papers.write_page(folder)
    page = (folder / papers.PAGE).read_text()
    assert ('| [A paper](#a-paper) | first \\| row (px) | > 1 | 2 | - |  | reproduced |'
            in page.replace('&gt;', '>'))
    assert '| A paper | 2 | 1 | 1 | 2 | 1 | 1 | 1 | 3 of 4 |' in page
    (folder / papers.RESULTS / 'quad.json').write_text(json.dumps({'rows': ROWS[1:]}))
    with pytest.raises(KeyError, match='first'):
        papers.write_page(folder)


def test_the_verdict_on_a_figure_is_that_of_its_claim(folder):
    result = folder / papers.RESULTS / 'quad.json'
    document = json.loads(result.read_text())
    document['rows'][0]['holds'] = False
    result.write_text(json.dumps(document))
    papers.write_page(folder)
    line = next(line for line in (folder / papers.PAGE).read_text().splitlines()
                if line.startswith('| [A paper]'))
    assert line.endswith('| does not hold |')


def test_campaigns_that_are_not_run_keep_their_result(folder, monkeypatch):
    monkeypatch.setattr(papers, '_run', lambda *arguments: Result(
        'campaign quad', [record('first | row', True)], {'trials': 7, 'seed': 2}, ('ours',)))
    kept = (folder / papers.RESULTS / 'quad.json').read_text()
    papers.run_papers_campaign(folder, seed=2, only=('hausdorff',))
    assert (folder / papers.RESULTS / 'quad.json').read_text() == kept
    papers.run_papers_campaign(folder, seed=2, only=('quad',))
    document = json.loads((folder / papers.RESULTS / 'quad.json').read_text())
    assert document['conditions'] == {'trials': 7, 'seed': 2} and document['commit']
    assert re.fullmatch(r'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00', document['date'])


def test_every_claim_of_the_five_papers_can_be_judged():
    assert len(PAPERS) == 5
    assert set(papers.CAMPAIGNS) == {'jpdaf', 'hausdorff', 'extended-grid', 'two-satellite',
                                     'centroid', 'quad'}
    for paper in PAPERS:
        items = Counter((claim.item, claim.says) for claim in paper.claims)
        assert items.most_common(1)[0][1] == 1
        for claim in paper.claims:
            re.compile(claim.rows)
            assert claim.state in ('reproduced', 'better', 'differs', 'cannot be')
            assert claim.why
            assert claim.rows or claim.picture or claim.state == 'cannot be'


def test_the_command_runs_a_campaign_and_prints_the_states(
        tmp_path, few_photographs, monkeypatch):
    monkeypatch.setenv('STARTRACKER_DATA', str(few_photographs))
    done = invoke('campaign', 'papers', '--only', 'centroid', '--trials', '20', '--json',
                  '--output', str(tmp_path))
    rows = json.loads(done.stdout)['rows']
    states = {row['state'] for row in rows if 'threshold' in row['claim']}
    assert states == {'differs'} and done.exit_code == 0
    assert (tmp_path / 'papers.md').read_text().startswith('# Five papers, row by row')
    assert (tmp_path / 'pictures/papers/centroid/thresholds.png').exists()


def test_an_unknown_campaign_is_wrong_use(tmp_path):
    done = invoke('campaign', 'papers', '--only', 'nothing', '--output', str(tmp_path))
    assert done.exit_code == 2 and 'no campaign nothing' in done.stderr
