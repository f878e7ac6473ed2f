# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A command that measures: its options are the arguments of the function that it runs."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import click
from startracker_ros.tools.cli.outcome import exit_1_on
from startracker_ros.tools.cli.shared import check_names, finish_measured, json_option, seed_option

_PACKAGE = 'startracker_evaluation'

Option = Callable[[Callable[..., Any]], Callable[..., Any]]

HARNESS = 'startracker_ros.ros.processes:HarnessError'
"""What systems of several processes raise when they do not work."""


def only_option(what: str) -> Option:
    """Return the option --only of what is run, by name."""
    return click.option('--only', multiple=True, metavar='NAME', help=f'{what} to run, by name.')


def measurement(group: click.Group, name: str, run: str, summary: str, *options: Option,
                known: str = '', kind: str = 'case', error: str = '') -> None:
    """
    Add a command that prints the result of a function, run = 'module:function' of this package.

    It is imported when the command runs. An option without a value has the default of the
    function. known is the name in its module of what --only takes, of this kind; error, as
    'module:class', is what ends the command with status 1.
    """
    def command(as_json: bool, **values: Any) -> None:
        function = _load(f'{_PACKAGE}.{run}')
        given = {option: value for option, value in values.items() if value != ()}
        if known:
            names = _load(f'{_PACKAGE}.{run.partition(":")[0]}:{known}')
            check_names(kind, given.get('only', ()), names)
        with exit_1_on(*([_load(error)] if error else [])):
            result = function(**given)
        finish_measured(result, as_json)
    for option in reversed((*options, seed_option, json_option)):
        command = option(command)
    group.command(name, help=summary)(command)


def _load(name: str) -> Any:
    module, _, attribute = name.partition(':')
    return getattr(import_module(module), attribute)
