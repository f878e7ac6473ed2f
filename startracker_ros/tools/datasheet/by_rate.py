# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rows of a data sheet as people read them: a figure in a line, the rates in columns."""

from collections.abc import Sequence
from dataclasses import dataclass, field
import math
import re

from startracker_ros.tools.datasheet.rows import SheetRow

_RATE = re.compile(r', ([\d.]+) deg/s')


@dataclass(frozen=True)
class SheetLine:
    """A figure: a row at each rate in deg/s, or one row at None where it has no rate."""

    section: str
    case: str
    unit: str
    rows: dict[float | None, SheetRow] = field(default_factory=dict)

    @property
    def first(self) -> SheetRow:
        """Return the row of the lowest rate, whose method and published figure are of all."""
        return next(iter(self.rows.values()))


def lines_of(table: Sequence[SheetRow]) -> list[SheetLine]:
    """Return the lines of a table, in the order of their first rows."""
    lines: dict[tuple[str, str, str], SheetLine] = {}
    for row in table:
        found = _RATE.search(row.case)
        line = SheetLine(row.section, _RATE.sub('', row.case), row.unit)
        lines.setdefault((line.section, line.case, line.unit), line).rows[
            float(found[1]) if found else None] = row
    return list(lines.values())


def rates_of(lines: Sequence[SheetLine]) -> list[float | None]:
    """Return the rates of some lines, None first."""
    return sorted({rate for line in lines for rate in line.rows},
                  key=lambda rate: -1.0 if rate is None else rate)


def records(table: Sequence[SheetRow]) -> list[dict[str, object]]:
    """Return the rows for a terminal: at rest or without a rate, then at the other rates."""
    lines = lines_of(table)
    rates = [rate for rate in rates_of(lines) if rate]
    return [{'figure': line.case, 'unit': line.unit,
             'at rest': _cell(line.rows.get(0.0, line.rows.get(None))),
             **{f'{rate:g} deg/s': _cell(line.rows.get(rate)) for rate in rates}}
            for line in lines]


def _cell(row: SheetRow | None) -> str:
    """Return the figure of a row, with its goal where that is missed."""
    missed = row is not None and row.goal.endswith('missed')
    return f'{number(row)} ({row.goal})' if row and missed else number(row)


def number(value: SheetRow | float | None) -> str:
    """Return a figure of three digits, or that of a row; a dash where there is none."""
    if isinstance(value, SheetRow):
        value = value.ours
    if value is None or not math.isfinite(value):
        return '-'
    return f'{value:.3g}' if abs(value) < 1000 else f'{value:.0f}'
