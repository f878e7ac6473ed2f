# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
All campaigns of papers in one run, and a page of every table, figure and claim with its state.

The results are kept as JSON files, and the page is made of them alone: a campaign that is run
again replaces its own.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
import re
from typing import Any

from startracker_evaluation.campaign.paper_claims import Claim, Paper, PAPERS
from startracker_evaluation.result_table import escaped, result_lines
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.machine import origin

CAMPAIGNS = tuple(name for paper in PAPERS for name in paper.campaigns)

PAGE, RESULTS, PICTURES = 'papers.md', 'results', 'pictures/papers'
"""The page, and the folders of the results and of the pictures next to it."""

_LEAST_TRIALS = {'two-satellite': 1000}


@dataclass(frozen=True)
class ClaimRow:
    """One table, figure or claim of a paper, and its state."""

    paper: str
    item: str
    claim: str
    state: str
    why: str
    holds: bool | None


def run_papers_campaign(folder: Path, *, seed: int, trials: int | None = None,
                        only: Sequence[str] = (), scheduler: str = '') -> Result:
    """
    Run the campaigns, or those named, write their results and the page; return its states.

    trials is that of each campaign, by default its own. Campaigns that are not run keep the
    result that is in the folder.
    """
    (folder / RESULTS).mkdir(parents=True, exist_ok=True)
    for name in only or CAMPAIGNS:
        pictures = folder / PICTURES / name
        pictures.mkdir(parents=True, exist_ok=True)
        result = _run(name, trials, seed, scheduler, pictures)
        document = replace(result, origin=origin()).document
        (folder / RESULTS / f'{name}.json').write_text(json.dumps(document, indent=1) + '\n')
    rows = write_page(folder)
    return Result('campaign papers', rows, {
        'page': str(folder / PAGE),
        'states': 'reproduced: as good as printed with the method of the paper; better: beyond '
                  'it; differs and cannot be: see why; not run: no result in the folder; too few '
                  'trials: run it with more',
        'trials': 'of each campaign' if trials is None else trials, 'seed': seed})


def _run(name: str, trials: int | None, seed: int, scheduler: str, output: Path) -> Result:
    """Run one campaign; the pictures are written to a folder."""
    # Imported here: each of them takes as long to import as all the rest.
    from startracker_evaluation.campaign.centroid import run_centroid_campaign
    from startracker_evaluation.campaign.extended_grid import run_extended_grid_campaign
    from startracker_evaluation.campaign.hausdorff import run_hausdorff_campaign
    from startracker_evaluation.campaign.jpdaf import run_jpdaf_campaign
    from startracker_evaluation.campaign.quad import run_quad_campaign
    from startracker_evaluation.campaign.two_satellite import run_two_satellite_campaign
    parallel = {'scheduler': scheduler}
    campaigns: dict[str, tuple[Callable[..., Result], int, dict[str, Any]]] = {
        'jpdaf': (run_jpdaf_campaign, 100, parallel),
        'hausdorff': (run_hausdorff_campaign, 2000, parallel),
        'extended-grid': (run_extended_grid_campaign, 10_000, parallel),
        'two-satellite': (run_two_satellite_campaign, 100_000, {}),
        'centroid': (run_centroid_campaign, 200, {}),
        'quad': (run_quad_campaign, 300, parallel)}
    run, default, options = campaigns[name]
    count = max(default if trials is None else trials, _LEAST_TRIALS.get(name, 1))
    return run(trials=count, seed=seed, output=output, **options)


def write_page(folder: Path) -> list[ClaimRow]:
    """Write the page from the results in the folder; return the state of each claim."""
    documents = {name: json.loads(path.read_text())
                 for name in CAMPAIGNS if (path := folder / RESULTS / f'{name}.json').exists()}
    rows: list[ClaimRow] = []
    sections: list[str] = []
    headlines: list[str] = []
    held: dict[str, str] = {}
    for paper in PAPERS:
        records = [row for name in paper.campaigns
                   for row in documents.get(name, {'rows': []})['rows']]
        pictures = {name: sorted(path.relative_to(folder).as_posix()
                                 for path in (folder / PICTURES / name).glob('*.[ps][nv]g'))
                    for name in paper.campaigns}
        states = [_state(paper, claim, records, sum(pictures.values(), []))
                  for claim in paper.claims]
        rows += states
        if all(name in documents for name in paper.campaigns):
            headlines += _headlines(paper, records, states)
        judged = [record['holds'] for record in records if record['holds'] is not None]
        held[paper.name] = f'{sum(judged)} of {len(judged)}'
        sections += [*_paper_section(paper, states),
                     *(line for name in paper.campaigns if name in documents
                       for line in _result_section(name, documents[name], pictures[name]))]
    head = ['# Five papers, row by row', '',
            'Written by `startracker campaign papers`, from the results in '
            f'[{RESULTS}]({RESULTS}): do not edit. Each campaign prints the figure of the paper, '
            "that of the paper's method in our implementation (as_published), and ours beyond it; "
            'holds says whether the bound next to them does.', '',
            'Verdicts. Reproduced: by the method of the paper, as good as printed or within the '
            'bound. Better: by a method beyond it. Differs: the section says why.', '',
            '| paper | figure | published | ours, as published | ours, beyond | bound | verdict |',
            '|---|---|---|---|---|---|---|', *headlines, '', *_summary(rows, held), '']
    (folder / PAGE).write_text('\n'.join([*head, *sections]).rstrip() + '\n')
    return rows


def _state(paper: Paper, claim: Claim, records: Sequence[dict], pictures: Sequence[str]
           ) -> ClaimRow:
    """Return a claim with the state that its rows and pictures show."""
    found = [record for record in records if claim.rows and re.search(claim.rows, record['case'])]
    failed = [record['case'] for record in found if record['holds'] is False]
    few = sum('too few trials' in record['bound'] for record in found)
    drawn = any(claim.picture in path for path in pictures) if claim.picture else True

    def row(state: str, why: str, holds: bool | None = None) -> ClaimRow:
        return ClaimRow(paper.name, claim.item, claim.says, state, why, holds)

    if claim.state == 'cannot be':
        return row(claim.state, claim.why)
    if not drawn or (claim.rows and not found):
        return row('not run', 'no such row' if drawn else 'no such picture')
    if failed and claim.state != 'differs':
        return row('does not hold', '; '.join(failed), False)
    if few:
        return row('too few trials', f'in {few} of {len(found)} rows')
    return row(claim.state, claim.why, True)


def _headlines(paper: Paper, records: Sequence[dict], states: Sequence[ClaimRow]
               ) -> Iterator[str]:
    """Yield a line for each main figure; one without a row or a claim is an error."""
    by_case = {record['case']: record for record in records}
    link = f'[{paper.name}](#{paper.name.lower().replace(" ", "-")})'
    for case in paper.headlines:
        row = by_case[case]
        state = next(state.state for claim, state in zip(paper.claims, states, strict=True)
                     if claim.rows and re.search(claim.rows, case))
        figures = ['-' if value is None else
                   f'{value:.4g}' if isinstance(value, float) else str(value)
                   for value in (row['paper'], row['as_published'], row.get('beyond'))]
        unit = f' ({row["unit"]})' if row['unit'] else ''
        cells = (case + unit, *figures, row['bound'], state)
        yield f'| {link} | {" | ".join(map(escaped, cells))} |'


def _summary(rows: Sequence[ClaimRow], held: dict[str, str]) -> Iterator[str]:
    """Yield a table of the claims of each paper in each state, and the rows that hold."""
    states = list(dict.fromkeys(row.state for row in rows))
    yield f'| paper | {" | ".join(states)} | rows that hold |'
    yield f'|---|{"---|" * len(states)}---|'
    for paper in PAPERS:
        own = [row.state for row in rows if row.paper == paper.name]
        counts = (str(own.count(state) or '') for state in states)
        yield f'| {paper.name} | {" | ".join(counts)} | {held[paper.name]} |'


def _paper_section(paper: Paper, states: Sequence[ClaimRow]) -> Iterator[str]:
    yield from (f'## {paper.name}', '', paper.source, '')
    yield 'Commands: ' + ', '.join(f'`startracker campaign {name}`' for name in paper.campaigns)
    yield from ('', '| item | claim | state | why |', '|---|---|---|---|')
    for row in states:
        yield f'| {row.item} | {escaped(row.claim)} | {row.state} | {escaped(row.why)} |'
    yield ''


def _result_section(name: str, document: dict, pictures: Sequence[str]) -> Iterator[str]:
    yield f'### startracker campaign {name}'
    yield from (*result_lines(document, f'{RESULTS}/{name}.json'), '')
    for path in pictures:
        yield from (f'![{Path(path).stem.replace("_", " ")}]({path})', '')
