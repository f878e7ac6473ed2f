# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How a command ends: its exit status, what it says of an error, of a file that is not there.

0: done. 1: the work failed; one line on stderr. 2: wrong use; usage and one line. 130: ended by
Ctrl-C. 141: nobody reads its output any more. With --json an error is a document as well.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import errno
import glob
import json
import os
from pathlib import Path
import sys
from typing import Any, cast, TYPE_CHECKING

import click
from startracker_ros.core.ctrl_c import INTERRUPTED
from startracker_ros.core.extras import MissingLibraryError, with_ros

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

    from click.shell_completion import CompletionItem

FAILED, BROKEN_PIPE = 1, 141


class FailedError(click.ClickException):
    """The work failed; the text says why."""

    exit_code = FAILED

    def show(self, file: Any = None) -> None:
        click.echo(f'startracker: {self.message}', file=file, err=True)


class _NoReaderError(Exception):
    """Nobody reads the output any more."""


class _NoArgumentsError(click.UsageError):
    """A command without arguments that needs some: the text is its help."""

    def __init__(self, ctx: click.Context) -> None:
        super().__init__(ctx.get_help(), ctx)

    def show(self, file: Any = None) -> None:
        click.echo(self.message, file=file, err=True)


class NeedsArguments(click.Command):
    """A command whose no_args_is_help is wrong use; click before 8.2 ends with status 0."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and self.no_args_is_help and not ctx.resilient_parsing:
            raise _NoArgumentsError(ctx)
        return super().parse_args(ctx, args)


class Commands(NeedsArguments, click.Group):
    """
    A group of commands, each listed with the whole of its first sentence.

    joined names the entry points by which commands of other distributions join it; those of ours
    that may not be installed are elsewhere, by name.
    """

    def __init__(self, *arguments: Any, joined: str = '', elsewhere: Sequence[str] = (),
                 **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._joined, self._elsewhere = joined, elsewhere
        self._sections: dict[str, list[str]] = {}

    def add_section(self, title: str, *commands: click.Command, elsewhere: Sequence[str] = ()
                    ) -> None:
        """Add commands, and the names of those of other distributions, under a title of help."""
        for command in commands:
            self.add_command(command)
        self._sections[title] = [*(str(command.name) for command in commands), *elsewhere]

    def _entry_points(self) -> 'EntryPoints':
        # Takes a quarter of the time of a help page to load.
        from importlib.metadata import entry_points, EntryPoints
        return entry_points(group=self._joined) if self._joined else EntryPoints()

    def every(self) -> dict[str, click.Command]:
        """Return all commands by name, with those of other distributions."""
        context = click.Context(self)
        return {name: cast(click.Command, self.get_command(context, name))
                for name in self.list_commands(context)}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *self._entry_points().names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None:
            for found in self._entry_points().select(name=cmd_name):
                return cast(click.Command, found.load())
            if cmd_name in self._elsewhere:
                raise MissingLibraryError(
                    f'{cmd_name} is a command of startracker-evaluation, which is not installed: '
                    'pip install ./evaluation in a clone')
        return command

    def by_section(self) -> dict[str, dict[str, click.Command]]:
        """Return every() by the titles of help; what has none is under Commands."""
        every = self.every()
        titled = {name for names in self._sections.values() for name in names}
        sections = {**self._sections, 'Commands': [name for name in every if name not in titled]}
        listed = {title: {name: every[name] for name in names if name in every}
                  for title, names in sections.items()}
        return {title: commands for title, commands in listed.items() if commands}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections = self.by_section()
        width = max(len(name) for commands in sections.values() for name in commands)
        for title, commands in sections.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), command.get_short_help_str(limit=10 ** 6))
                                    for name, command in commands.items()])


class Main(Commands):
    """The group of all commands, where every one of them ends."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with with_ros():
                return super().invoke(ctx)
        except BrokenPipeError as error:
            # click would end with status 1.
            raise _NoReaderError from error

    def main(self, args: Sequence[str] | None = None, prog_name: str | None = None,
             complete_var: str | None = None, standalone_mode: bool = True,
             windows_expand_args: bool = True, **extra: Any) -> Any:
        words = sys.argv[1:] if args is None else [*args]
        if not standalone_mode:
            return super().main(words, prog_name, complete_var, standalone_mode=False,
                                windows_expand_args=windows_expand_args, **extra)
        try:
            try:
                status = super().main(words, prog_name, complete_var, standalone_mode=False,
                                      windows_expand_args=windows_expand_args, **extra)
            finally:
                # Here, where a reader that has left is not an error.
                sys.stdout.flush()
        except (BrokenPipeError, _NoReaderError):
            # The interpreter flushes once more when it ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            sys.exit(BROKEN_PIPE)
        except click.Abort:
            _interrupted()
        except SystemError as error:
            # Compiled code that Ctrl-C interrupts.
            if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
                raise
            _interrupted()
        except (click.ClickException, MissingLibraryError, OSError) as error:
            self._fail(error if isinstance(error, click.ClickException) else
                       FailedError(_text(error)), words)
        sys.exit(status if isinstance(status, int) else 0)

    def _fail(self, error: click.ClickException, words: Sequence[str]) -> None:
        error.show()
        if '--json' in words:
            print(json.dumps({
                'name': self._name_of(words), 'conditions': {}, 'rows': [],
                'error': error.format_message(), 'status': error.exit_code}))
        sys.exit(error.exit_code)

    def _name_of(self, words: Sequence[str]) -> str:
        """Return the name of the command that was called, as `campaign jpdaf`."""
        command: click.Command = self
        names = []
        for word in words:
            context = click.Context(command)
            if isinstance(command, Commands) and word in command.list_commands(context):
                command = cast(click.Command, command.get_command(context, word))
                names.append(word)
        return ' '.join(names)


def _interrupted() -> None:
    click.echo('startracker: stopped', err=True)
    sys.exit(INTERRUPTED)


def _text(error: Exception, output: Path | None = None) -> str:
    """Return an error in a line; one of the system names its file, or else the output."""
    if isinstance(error, OSError) and type(error).__str__ is OSError.__str__ and error.strerror:
        name = error.filename or output
        return f'{name}: {error.strerror}' if name else error.strerror
    return str(error)


@contextmanager
def usage_error_on(*errors: type[Exception]) -> Iterator[None]:
    """End with status 2, wrong use, on these errors."""
    try:
        yield
    except errors as error:
        raise click.UsageError(str(error)) from error


@contextmanager
def exit_1_on(*errors: type[Exception], output: Path | None = None) -> Iterator[None]:
    """End with status 1 on these errors, and on errors of the system while writing output."""
    try:
        yield
    except BrokenPipeError:
        raise
    except errors + (OSError,) as error:
        raise FailedError(_text(error, output)) from error


# --- values of options; a file that is not there is an error before anything is loaded ---

FOV_DEG = click.FloatRange(0, 360, min_open=True)


class EpochYear(click.ParamType):
    """A Julian year, or a time UTC like 2026-11-23T01:30:00Z."""

    name = 'year|time'

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> float:
        from startracker_ros.core.astro.epoch import julian_year
        try:
            return julian_year(value)
        except ValueError as error:
            self.fail(str(error))


class InputPath(click.Path):
    """The path of a file or folder to read: status 1 where it is not there."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        _require(str(value))
        return super().convert(value, param, ctx)


class InputName(click.ParamType):
    """What may also be a pattern, a URL or a device: status 1 for a path that is not there."""

    name = 'path'

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str
                       ) -> list['CompletionItem']:
        from click.shell_completion import CompletionItem
        return [CompletionItem(incomplete, type='file')]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if not (glob.has_magic(value) or '://' in value or value.startswith('/dev/')):
            _require(value)
        return value


def require_some(names: Sequence[Path]) -> None:
    """Fail where none of the files, folders and patterns is there: the others are results."""
    if not any(name.exists() or glob.glob(str(name), recursive=True) for name in names):
        _require(str(names[0]))


def _require(path: str) -> None:
    if not os.path.exists(path):
        raise FailedError(f'{path}: {os.strerror(errno.ENOENT)}')
