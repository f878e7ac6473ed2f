# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results as a table for people or one JSON document for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
import json
import math
from typing import Any

from rich import box
from rich.console import Console
from startracker_ros.io.table_layout import Column, FILE_WIDTH, fit


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
    # Texts are data: brackets and colons in them are no markup.
    console = Console(markup=False, emoji=False, highlight=False)
    names = [name for name in (rows[0] if rows else ()) if name not in result.details]
    layout = fit([_column(name, rows) for name in names],
                 console.width if console.is_terminal and not wide else FILE_WIDTH,
                 drop=console.is_terminal and not wide)
    remarks = {key: f'{cell_text(key, value)} {result.notes.get(key, "")}'.rstrip()
               for key, value in conditions.items()}
    if layout.left_out:
        remarks = {'not shown': f'{", ".join(layout.left_out)}; all with --wide', **remarks}
    # rich would end the process where nobody reads any more.
    with console.capture() as text:
        console.print(result.name, style='italic', soft_wrap=True)
        for line in layout.lines(box.HEAVY_HEAD.substitute(console.options)):
            console.print(line, soft_wrap=True)
        for key, remark in remarks.items():
            console.print(f'  {key}: {remark}', soft_wrap=not console.is_terminal)
    print(text.get(), end='')


def _column(name: str, rows: Sequence[Mapping[str, object]]) -> Column:
    return Column(name, [cell_text(name, None if _is_unbounded(name, row) else row[name])
                         for row in rows],
                  any(isinstance(row[name], (int, float)) for row in rows))


def _is_unbounded(name: str, row: Mapping[str, object]) -> bool:
    """Return whether a row holds only as nothing bounds it."""
    return name == 'holds' and row[name] is True and row.get('bound') == ''
