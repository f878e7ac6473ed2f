"""Results as a table for people or one JSON document for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
import json
import math
from typing import Any

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Result:
    """
    Rows of one command, and the conditions under which they were made.

    A row is a dataclass or a mapping, all with the same columns. details are columns of the
    JSON document that the table leaves out.
    """

    name: str
    rows: Sequence[Any]
    conditions: Mapping[str, object] = field(default_factory=dict)
    details: Sequence[str] = ()

    @property
    def records(self) -> list[dict[str, object]]:
        """Return the rows as JSON values by column."""
        return [_plain_values(row if isinstance(row, Mapping) else asdict(row))
                for row in self.rows]

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


def _text(name: str, value: object) -> str:
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


def show(result: Result, as_json: bool) -> None:
    """Print a result; both forms hold the same rows, the table without the details."""
    rows, conditions = result.records, _plain_values(result.conditions)
    if as_json:
        print(json.dumps({'name': result.name, 'conditions': conditions, 'rows': rows}))
        return
    rows = [{key: value for key, value in row.items() if key not in result.details}
            for row in rows]
    table = Table(title=result.name, title_justify='left', header_style='bold')
    for key in rows[0] if rows else ():
        numeric = any(isinstance(row[key], (int, float)) for row in rows)
        table.add_column(key, justify='right' if numeric else 'left', overflow='fold')
    for row in rows:
        table.add_row(*(_text(name, value) for name, value in row.items()))
    # Texts are data: brackets and colons in them are no markup.
    console = Console(markup=False, emoji=False)
    console.print(table)
    for key, value in conditions.items():
        console.print(f'  {key}: {_text(key, value)}', highlight=False)
