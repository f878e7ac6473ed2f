# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results as a table for people or one JSON document for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
import json
import math
from textwrap import wrap
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

_FILE_WIDTH = 160
"""Of a table in a pipe or a file, in characters, as far as that is possible."""

# A column with a longer text is a remark, which may stand below the table.
_REMARK = 24
# The first column names the row; where space is short it is folded between words to this width.
_FOLDED = 32
# Of so many columns one at least is in a table.
_LEAST_SHOWN = 3
# Whether a row holds is never left out.
_ALWAYS = ('holds',)
_NOTHING = ('', '-')


@dataclass(frozen=True)
class Result:
    """
    Rows of one command, and the conditions under which they were made.

    A row is a dataclass or a mapping, all with the same columns. details are columns of the
    JSON document that the table leaves out; notes are what people read behind conditions, as
    their units; origin is where a measured result is from, for the document.
    """

    name: str
    rows: Sequence[Any]
    conditions: Mapping[str, object] = field(default_factory=dict)
    details: Sequence[str] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    origin: Mapping[str, object] = field(default_factory=dict)

    @property
    def records(self) -> list[dict[str, object]]:
        """Return the rows as JSON values by column."""
        return [_plain_values(row if isinstance(row, Mapping) else asdict(row))
                for row in self.rows]

    @property
    def document(self) -> dict[str, object]:
        """Return the JSON document of --json."""
        kept = {'details': list(self.details)} if self.details else {}
        return {'name': self.name, 'conditions': _plain_values(self.conditions),
                'rows': self.records, **kept, **self.origin}

    @property
    def holds(self) -> bool:
        """Return whether all rows hold, as one without a bound, holds missing or None, does."""
        return all(record.get('holds') in (None, True) for record in self.records)


def _plain_values(record: Mapping[str, object]) -> dict[str, object]:
    return {key: _plain(value) for key, value in record.items()}


def _plain(value: object) -> object:
    """Return a JSON value: NumPy scalars unpacked, no NaN, which JSON does not have."""
    if hasattr(value, 'item'):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def cell_text(name: str, value: object) -> str:
    """Return a plain value as a cell of a column."""
    if value is None:
        return '-'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, float):
        # Four decimals of a degree resolve an arcsecond; other figures have four digits.
        if name.endswith('_deg'):
            return f'{value:.4f}'
        return f'{value:.4g}' if abs(value) < 1000 else f'{value:.2f}'
    return str(value)


def show(result: Result, as_json: bool, wide: bool = False) -> None:
    """
    Print a result; the JSON document and the table of all columns hold the same rows.

    The details are in the JSON document only. A terminal shows as many columns as fit, all with
    wide. A pipe or a file receives all.
    """
    if as_json:
        print(json.dumps(result.document))
        return
    rows, conditions = result.records, _plain_values(result.conditions)
    # Texts are data: brackets and colons in them are not markup.
    console = Console(markup=False, emoji=False, highlight=False)
    columns = [_column(name, rows) for name in (rows[0] if rows else ())
               if name not in result.details]
    # rich would end the process where nobody reads any more.
    with console.capture() as text:
        console.print(result.name, style='italic', soft_wrap=True)
        drop = console.is_terminal and not wide
        left_out = _print_rows(console, columns, console.width if drop else _FILE_WIDTH, drop)
        remarks = {key: f'{cell_text(key, value)} {result.notes.get(key, "")}'.rstrip()
                   for key, value in conditions.items()}
        if left_out:
            remarks = {'not shown': f'{", ".join(left_out)}; all with --wide', **remarks}
        for key, remark in remarks.items():
            line = f'{key}: {remark}'
            parts = _folded(line, console.width, '  ') if console.is_terminal else [f'  {line}']
            console.print('\n'.join(parts), soft_wrap=True)
    print(text.get(), end='')


@dataclass(frozen=True)
class _Column:
    """A column: one text for each row."""

    name: str
    texts: Sequence[str]
    numeric: bool

    @property
    def is_remark(self) -> bool:
        return not self.numeric and self.width > _REMARK

    @property
    def width(self) -> int:
        return max(map(cell_len, self.texts))


def _column(name: str, rows: Sequence[Mapping[str, object]]) -> _Column:
    texts = [cell_text(name, None if _is_unbounded(name, row) else row[name]) for row in rows]
    return _Column(name, [text.replace('\n', ' ') for text in texts],
                   any(isinstance(row[name], (int, float)) for row in rows))


def _is_unbounded(name: str, row: Mapping[str, object]) -> bool:
    """Return whether a row holds only as nothing bounds it."""
    return name == 'holds' and row[name] is True and row.get('bound') == ''


def _print_rows(console: Console, columns: Sequence[_Column], width: int, drop: bool
                ) -> Sequence[str]:
    """
    Print rows in lines of at most width characters, as far as possible; return what is left out.

    Where they are wider, remarks go below the table. Where they still are, the first column and
    the headers are folded between words, and, if drop is set, columns are left out from the
    right; where most would be, or are remarks, the rows are paragraphs. No word is broken.
    """
    if not columns:
        return ()
    table, shown, below = _table(columns), [*columns], list[_Column]()
    if _width(table) > width:
        below = [column for column in columns[1:] if column.is_remark]
        shown = [column for column in columns if column not in below]
        table = _table(shown)
    if _width(table) > width:
        table = _table(shown, narrow=True)
    while drop and _width(table) > width and (
            optional := [column for column in shown[1:] if column.name not in _ALWAYS]):
        shown.remove(optional[-1])
        table = _table(shown, narrow=True)
    is_table = (len(shown) * _LEAST_SHOWN >= len(columns) - len(below)
                and len(shown) >= len(below))
    if is_table:
        console.print(table, crop=False)
    lines: list[str] = []
    for row, first in enumerate(columns[0].texts):
        rest = [(column.name, column.texts[row]) for column in (below if is_table else columns[1:])
                if column.texts[row] not in _NOTHING]
        if is_table:
            for name, text in rest:
                lines += _folded(f'{first}: {name}: {text}', width, '  ')
        else:
            lines += _folded(first, width)
            lines += _folded('  '.join(f'{name} {text}' for name, text in rest), width, '  ')
    for line in lines:
        console.print(line, soft_wrap=True)
    return [column.name for column in columns if is_table and column not in [*shown, *below]]


def _table(columns: Sequence[_Column], narrow: bool = False) -> Table:
    """Return the table of columns, as wide as they are; narrow: with lines folded."""
    table = Table(box=box.HEAVY_HEAD)
    for column in columns:
        header, width = column.name, column.width
        if narrow and column is columns[0]:
            width = max(cell_len(line) for text in column.texts for line in _folded(text, _FOLDED))
        if narrow and cell_len(header) > width:
            header = header.replace('_', '\n')
        width = max(width, *map(cell_len, header.split('\n')))
        table.add_column(header, justify='right' if column.numeric else 'left', width=width)
    for row in zip(*(column.texts for column in columns)):
        table.add_row(*row)
    table.width = _width(table)
    return table


def _width(table: Table) -> int:
    """Return the width of a table: columns with a space on either side, lines between them."""
    return sum(3 + (column.width or 0) for column in table.columns) + 1


def _folded(text: str, width: int, indent: str = '') -> list[str]:
    """Return the lines of a text; a word that is longer than the width is not broken."""
    return wrap(text, width, initial_indent=indent, subsequent_indent=indent,
                break_long_words=False, break_on_hyphens=False) or ['']
