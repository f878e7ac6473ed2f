# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the commands share: options, and the printing of results."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import sys
from typing import Any, NoReturn, TYPE_CHECKING, TypeVar

import click
from startracker_ros.core.extras import new_figure
from startracker_ros.io.output import output_folder
from startracker_ros.io.progress import print_lines

if TYPE_CHECKING:
    from startracker_ros.io.table import Result

_Command = TypeVar('_Command', bound=Callable[..., Any])

_WIDE = 'startracker_ros.wide'


def _set_wide(context: click.Context, option: click.Parameter, wide: bool) -> None:
    context.meta[_WIDE] = wide


def _set_lines(context: click.Context, option: click.Parameter, as_json: bool) -> bool:
    print_lines(not as_json)
    return as_json


def json_option(command: _Command) -> _Command:
    """Add --json, which the command passes on with its result, and --wide."""
    wide = click.option('--wide', is_flag=True, expose_value=False, callback=_set_wide,
                        help='Print all columns, however narrow the terminal is.')
    return wide(click.option('--json', 'as_json', is_flag=True, callback=_set_lines,
                             help='Print one JSON document.')(command))


scheduler_option = click.option('--scheduler', default='', metavar='ADDRESS',
                                help='Dask cluster to use instead of the cores of this machine.')
namespace_option = click.option('--namespace', metavar='NAME',
                                help='Of the star tracker.  [default: the only one in the bag]')
seed_option = click.option('--seed', type=click.IntRange(0), default=1, show_default=True,
                           metavar='N',
                           help='Of all random numbers: the same ones give the same result.')


def trials_option(default: int, what: str, *, least: int = 1) -> Callable[[_Command], _Command]:
    """Return the option --trials; what is the help text."""
    return click.option('--trials', type=click.IntRange(least), default=default,
                        show_default=True, metavar='N', help=what)


def output_option(default: str, what: str, *, folder: bool = True
                  ) -> Callable[[_Command], _Command]:
    """Return the option --output of a command that writes a folder or a file; what is its help."""
    return click.option('-o', '--output', default=default, show_default=True, help=what,
                        metavar='FOLDER' if folder else 'FILE',
                        type=click.Path(path_type=Path, file_okay=not folder, dir_okay=folder))


def picture_option(what: str) -> Callable[[_Command], _Command]:
    """Return the option --output of a command that draws a picture into that folder."""
    return click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False),
                        callback=check_pictures, metavar='FOLDER',
                        help=f'Folder for a picture of {what}.')


def check_pictures(context: click.Context, option: click.Parameter, folder: Path | None
                   ) -> Path | None:
    """Fail before a long campaign, not after it, where matplotlib or the folder is missing."""
    if folder is not None:
        new_figure()
        output_folder(folder)
    return folder


def become_node(node: str, arguments: Sequence[str]) -> NoReturn:
    """Replace this process by that of a node; KeyError for an unknown name."""
    from startracker_ros.ros.processes import node_command, node_environment
    if find_spec('rclpy') is None:
        raise ModuleNotFoundError(name='rclpy')
    command = node_command(node, arguments)
    # What comes while the node is imported waits for its handlers (ros/shutdown.py).
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.execve(command[0], command, node_environment())


def print_result(result: 'Result', as_json: bool) -> None:
    """Print a result as --json and --wide of the command request."""
    from startracker_ros.io.table import show
    context = click.get_current_context(silent=True)
    show(result, as_json, context is not None and context.meta.get(_WIDE, False))


def finish(result: 'Result', as_json: bool) -> None:
    """Print a result; status 1 when a row does not hold."""
    print_result(result, as_json)
    if not result.holds:
        sys.exit(1)


def finish_measured(result: 'Result', as_json: bool) -> None:
    """Finish as finish() does; the document says where the result is from."""
    from startracker_ros.tools.figures.machine import origin
    finish(replace(result, origin=origin()), as_json)


def check_names(kind: str, named: Iterable[str], known: Iterable[str]) -> None:
    """Reject names that are not known; UsageError lists those that are."""
    unknown = set(named) - set(known)
    if unknown:
        raise click.UsageError(f'no {kind} {", ".join(sorted(unknown))}; there are '
                               f'{", ".join(known)}')
