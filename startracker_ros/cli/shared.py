"""What the commands share: options, and how they end."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
import sys
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from startracker_ros.table import Result

json_option = click.option('--json', 'as_json', is_flag=True, help='Print one JSON document.')
scheduler_option = click.option('--scheduler', default='', metavar='ADDRESS',
                                help='Dask cluster to use instead of the cores of this machine.')
namespace_option = click.option('--namespace', metavar='NAME',
                                help='Of the star tracker.  [default: the only one in the bag]')
seed_option = click.option('--seed', type=click.IntRange(0), default=1, show_default=True)


def finish(result: 'Result', as_json: bool) -> None:
    """Print a result; status 1 when a row does not hold."""
    from startracker_ros.table import show
    show(result, as_json)
    if not all(row.get('holds', True) for row in result.rows):
        sys.exit(1)


def _fail(message: str) -> None:
    """End with status 1: the work failed."""
    click.echo(f'startracker: {message}', err=True)
    sys.exit(1)


@contextmanager
def told(*errors: type[Exception], output: Path | None = None) -> Iterator[None]:
    """End with status 1 on these errors, and on those of the system where output is written."""
    try:
        yield
    except errors as error:
        _fail(str(error))
    except OSError as error:
        if output is None:
            raise
        _fail(f'{output}: {error.strerror}')


def check_names(kind: str, named: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that are not known."""
    unknown = set(named) - set(known)
    if unknown:
        raise click.UsageError(f'no {kind} {", ".join(sorted(unknown))}; there are '
                               f'{", ".join(known)}')
