# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The reference of the commands out of their options: python -m startracker_ros.commands_page.

Writes docs/commands.md of the source tree it is started in.
"""

from collections.abc import Iterator
import inspect

import click
from startracker_ros.command_line import main
from startracker_ros.io.output import write_output
from startracker_ros.tools.cli.outcome import Commands

PAGE = 'docs/commands.md'
_TEXT = """\
# Commands

Made by `python -m startracker_ros.commands_page` from the options in the code. `--help` of a
command prints the same.

## What all share

| exit status | meaning |
|---|---|
| 0 | done; `record`, `play` and `run` end with it by Ctrl-C, too, and `live` once it has a lens |
| 1 | the work failed: no attitude, a row that does not hold, a file; one line on stderr |
| 2 | wrong use: usage and one line on stderr |
| 130 | ended by Ctrl-C, at once; demos and campaigns of nodes end these first, a bag is closed |
| 141 | nobody reads the output any more, as behind `head` |

- **`--json`** prints one document `{"name", "conditions", "rows"}`. That of an error has no rows,
  and `error` and `status` besides; that of a demo, bench or campaign says in `commit`,
  `machine`, `date` and `code` where the figures are from. Kept as `docs/results/NAME.json` it is
  a table of these pages: `python -m startracker_evaluation.documents`.
- **Outputs** are written under another name and renamed when they are complete: a full disk leaves
  what was there before. A file needs a folder that is there; a folder for files is made.
- **Terminals.** A table has as many columns as fit, all with `--wide`; on a narrow terminal its
  rows are paragraphs. `NO_COLOR` is respected. Files and pipes receive all columns.
- **Progress** of long work is a bar on stderr. Where stderr is not a terminal, `solve`,
  `catalogue` and `night` write a line there every few seconds, with `--json` none.

## Completion in the shell

Tab completes commands, options, files and names of nodes, after one line in the start-up file of
the shell:

| shell | line |
|---|---|
| bash, `~/.bashrc` | `eval "$(_STARTRACKER_COMPLETE=bash_source startracker)"` |
| zsh, `~/.zshrc` | `eval "$(_STARTRACKER_COMPLETE=zsh_source startracker)"` |
| fish, `config.fish` | `_STARTRACKER_COMPLETE=fish_source startracker \\| source` |
"""


def page_text() -> str:
    """Return the page of all commands."""
    return '\n'.join([_TEXT, *_sections(main, 'startracker')])


def _sections(command: click.Command, name: str) -> Iterator[str]:
    """Yield the lines of a command, then those of its own commands."""
    with click.Context(command, info_name=name, terminal_width=10 ** 6,
                       max_content_width=10 ** 6) as context:
        if name != 'startracker':
            arguments = ' '.join(command.collect_usage_pieces(context))
            yield from ('', f'### {name}', '', f'Usage: `{arguments}`', '')
            yield inspect.cleandoc(command.help or '')
            records = [record for option in command.get_params(context)
                       if isinstance(option, click.Option) and '--help' not in option.opts
                       and (record := option.get_help_record(context))]
            if records:
                yield from ('', '| option | meaning |', '|---|---|')
            for option, meaning in records:
                yield f'| `{_cell(option)}` | {_cell(meaning)} |'
            if command.epilog:
                yield from ('', *_epilog(command.epilog))
    if isinstance(command, Commands):
        for title, commands in command.by_section().items():
            if name == 'startracker':
                yield from ('', f'## {title}')
            for each, sub in commands.items():
                yield from _sections(sub, f'{name} {each}')


def _cell(text: str) -> str:
    return ' '.join(text.split()).replace('|', '\\|').replace('*', '\\*')


def _epilog(text: str) -> Iterator[str]:
    """Yield the lines of an epilog, examples as a listing."""
    if not text.startswith('\b'):
        yield text
        return
    title, *examples = text.strip('\b\n').splitlines()
    yield from (title, '', '```', *(line.strip() for line in examples), '```')


if __name__ == '__main__':
    write_output(PAGE, page_text())
