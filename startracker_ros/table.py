"""Results as a table for people or one JSON document for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import json
import math

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Result:
    """Rows of one command, and the conditions under which they were made."""

    name: str
    rows: Sequence[Mapping[str, object]]
    conditions: Mapping[str, object] = field(default_factory=dict)


def _plain(value: object) -> object:
    """Return a JSON value: NumPy scalars unpacked, no NaN, which JSON does not have."""
    if hasattr(value, 'item'):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _text(name: str, value: object) -> str:
    value = _plain(value)
    if value is None:
        return '-'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, float):
        # Angles are worth their arcseconds, other figures four digits.
        if name.endswith('_deg'):
            return f'{value:.4f}'
        return f'{value:.4g}' if abs(value) < 1000 else f'{value:.2f}'
    return str(value)


def show(result: Result, as_json: bool) -> None:
    """Print a result; both forms hold the same rows."""
    rows = [{key: _plain(value) for key, value in row.items()} for row in result.rows]
    conditions = {key: _plain(value) for key, value in result.conditions.items()}
    if as_json:
        print(json.dumps({'name': result.name, 'conditions': conditions, 'rows': rows}))
        return
    table = Table(title=result.name, title_justify='left', header_style='bold')
    for key in rows[0] if rows else ():
        numeric = any(isinstance(row[key], (int, float)) for row in rows)
        table.add_column(key, justify='right' if numeric else 'left', overflow='fold')
    for row in result.rows:
        table.add_row(*(_text(name, value) for name, value in row.items()))
    # Texts are data: brackets and colons in them are no markup.
    console = Console(markup=False, emoji=False)
    console.print(table)
    for key, value in conditions.items():
        console.print(f'  {key}: {_text(key, value)}', highlight=False)
