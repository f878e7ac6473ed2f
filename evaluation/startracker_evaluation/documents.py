# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Tables of measured figures in README.md and docs: python -m startracker_evaluation.documents.

A result is the document that a command prints with --json, kept as docs/results/NAME.json. A
page shows it between two comments; columns and rows of an excerpt are named in the first one:

    <!-- result smear -->
    <!-- result pipeline: case, ours, unit: ^1024 px -->
    <!-- result lost-in-space: cell, median_ms / p99_ms of each solver: ^A12$ -->
    <!-- end of result -->

Run in the source tree, this writes these tables and docs/papers.md again, the results with a line
for each value, and names each result that is older than the code it measures.
"""

from collections.abc import Iterator
import json
import os
from pathlib import Path
import re
import subprocess
from typing import Any

from startracker_evaluation.campaign.papers import RESULTS, write_page
from startracker_evaluation.result_table import result_lines

_TABLE = re.compile(r'(<!-- result (?P<name>[\w-]+)(?:: (?P<columns>[^:\n]*))?'
                    r'(?:: (?P<rows>.*))? -->)(?s:.*?)(<!-- end of result -->)')


def pages(root: Path) -> list[Path]:
    """Return the pages of a source tree that may show results."""
    return [root / 'README.md', *sorted((root / 'docs').rglob('*.md'))]


def rendered(page: Path, root: Path) -> str:
    """Return the text of a page with the tables of its results as they are now."""
    folder = root / 'docs' / RESULTS

    def table(found: re.Match[str]) -> str:
        path = folder / f'{found["name"]}.json'
        link = Path(os.path.relpath(path, page.parent)).as_posix()
        lines = result_lines(json.loads(path.read_text()), link,
                             columns=[name.strip() for name in (found['columns'] or '').split(',')
                                      if name.strip()], rows=found['rows'] or '')
        return '\n'.join([found[1], *lines, '', found[5]])

    return _TABLE.sub(table, page.read_text())


def outdated(root: Path) -> Iterator[str]:
    """Yield a line for each result that is older than the code it measures."""
    for path in sorted((root / 'docs' / RESULTS).glob('*.json')):
        document = json.loads(path.read_text())
        newer = _commits_since(document, root)
        if newer is None:
            yield f'{path.name}: commit {document["commit"]} is not known here'
        elif newer:
            yield f'{path.name}: {newer} commits older than what it measures'


def _commits_since(document: dict[str, Any], root: Path) -> int | None:
    """Return the number of commits to the code of a result since it was measured."""
    code = [_source(path) for path in document['code']]
    try:
        done = subprocess.run(
            ['git', 'rev-list', '--count', f'{document["commit"].rstrip("+")}..HEAD', '--', *code],
            cwd=root, text=True, capture_output=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return int(done.stdout)


# Files that results name, and where their content is now.
_MERGED = {'bench/bag_read.py': 'bench/bag.py', 'bench/photographs.py': 'bench/real_sky.py',
           'bench/sparse_bag.py': 'bench/constellation.py',
           'campaign/heads_hint.py': 'campaign/heads.py',
           'campaign/heads_tracker.py': 'campaign/heads.py',
           'campaign/integrity_images.py': 'campaign/integrity.py'}


def _source(path: str) -> str:
    """Return the path in the repository of a folder or file that a result names."""
    folder, _, rest = path.partition('/')
    rest = _MERGED.get(rest, rest)
    return (f'evaluation/startracker_evaluation/{rest}' if folder == 'evaluation' else
            f'startracker_ros/{path}')


def main(root: Path = Path()) -> None:
    """Write results and the tables of all pages of a source tree; print what is outdated."""
    for path in (root / 'docs' / RESULTS).glob('*.json'):
        path.write_text(json.dumps(json.loads(path.read_text()), indent=1) + '\n')
    write_page(root / 'docs')
    for page in pages(root):
        page.write_text(rendered(page, root))
    for line in outdated(root):
        print(line)


if __name__ == '__main__':
    main()
