# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A kept result, the JSON document of a command that measures, as tables of Markdown."""

from collections.abc import Iterator, Mapping, Sequence
import re
from typing import Any

from startracker_ros.io.table import cell_text


def result_lines(document: Mapping[str, Any], link: str, *, columns: Sequence[str] = (),
                 rows: str = '') -> Iterator[str]:
    """
    Yield the lines of a result: an empty one, rows, where they are from, conditions.

    link is the path of the document as the page sees it. An excerpt has the columns that are
    named and the rows with a text in which rows, a regular expression, is found; no conditions.
    The last of the columns may be `ONE / OTHER of each COLUMN`: see side_by_side().
    """
    found = [row for row in document['rows'] if any(
        re.search(rows, text) for text in row.values() if isinstance(text, str))]
    details = document.get('details', ())
    shown = list(columns) or [key for key in document['rows'][0] if key not in details]
    values, each, by = shown[-1].partition(' of each ')
    if each:
        found = side_by_side(found, shown[:-1], by, values.split(' / '))
        shown = list(found[0])
    yield ''
    yield from table_lines(shown, found)
    conditions = document['conditions']
    counts = ''.join(f', {key} {conditions[key]}' for key in ('seed', 'trials')
                     if key in conditions)
    yield from ('', f'[{link.rpartition("/")[2]}]({link}): {document["date"]}, commit '
                    f'{document["commit"]}{counts}; {document["machine"]}')
    others = [(key, value) for key, value in conditions.items()
              if key not in ('seed', 'trials', 'machine')]
    if others and not columns and not rows:
        yield from ('', '| condition | |', '|---|---|')
        yield from (f'| {key} | {escaped(cell_text(key, value))} |' for key, value in others)


def side_by_side(rows: Sequence[Mapping[str, Any]], keys: Sequence[str], by: str,
                 values: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return one row for those that agree in the columns keys, with a column for each text in `by`.

    Its cells are the values of that text, separated by slashes.
    """
    joined: dict[tuple[Any, ...], dict[str, Any]] = {}
    texts = dict.fromkeys(row[by] for row in rows)
    for row in rows:
        key = tuple(row[name] for name in keys)
        cells = joined.setdefault(key, {**dict(zip(keys, key)), **dict.fromkeys(texts)})
        cells[row[by]] = ' / '.join(cell_text(name, row[name]) for name in values)
    return list(joined.values())


def table_lines(columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a table of columns of rows."""
    yield f'| {" | ".join(columns)} |'
    yield f'|{"---|" * len(columns)}'
    for row in rows:
        # What has no bound holds, which says nothing.
        shown = row if row.get('bound', True) else {**row, 'holds': None}
        yield f'| {" | ".join(escaped(cell_text(key, shown[key])) for key in columns)} |'


def escaped(text: str) -> str:
    """Return a text that a cell of a Markdown table can hold."""
    return text.replace('|', '\\|').replace('<', '&lt;').replace('\n', ' ')
