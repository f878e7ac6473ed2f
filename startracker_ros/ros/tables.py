# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Annotated YAML and documentation from tables in the code: python -m startracker_ros.ros.tables.

Writes config/<node>.yaml, docs/parameters.md and the table of docs/integrity.md of the source
tree it is started in.
"""

from pathlib import Path
import re
import textwrap

from startracker_ros.core.integrity.checks import Check, CHECKS
from startracker_ros.core.options import Option, yaml_value
from startracker_ros.ros.executables import NODES
from startracker_ros.ros.node import node_class_of

_COMMAND = 'python -m startracker_ros.ros.tables'


def node_rows(node: str) -> list[Option]:
    """Return the parameter table of one node."""
    return [row for options in node_class_of(node).option_classes for row in options.table()]


def _change(row: Option) -> str:
    return 'read only' if row.read_only else 'live' if row.live else ''


def _facts(row: Option) -> str:
    facts = [row.unit, row.range_text, _change(row)]
    return '; '.join(fact for fact in facts if fact)


def yaml_text(node: str) -> str:
    """Return the annotated parameter file of one node."""
    lines = [f'# Every parameter of {node} with its default. Made by `{_COMMAND}`.',
             f'/**/{node}:', '  ros__parameters:']
    for row in node_rows(node):
        note = f'{row.description} ({_facts(row)})' if _facts(row) else row.description
        lines += [f'    # {line}' for line in textwrap.wrap(note, 92)]
        lines.append(f'    {row.name}: {yaml_value(row.default)}')
    return '\n'.join(lines) + '\n'


def markdown_text() -> str:
    """Return the page of all parameter tables."""
    lines = [
        '# Parameters', '',
        f'Made by `{_COMMAND}` from the option tables in the code. A value out of range, of the',
        'wrong type or with an unknown name stops the node at its start: exit status 2, and a',
        'message that names it and the closest known name. A change at run time is rejected with',
        'the same message. An accepted change takes',
        'effect with the next frame. It resets a stateful node unless the parameter is marked',
        'live. Setting a parameter to its current value has no effect: `ros2 param load` of the',
        'dump of a node resets nothing.', '',
        'An unknown name stops the node where it is meant for it: `-p NAME:=VALUE`,',
        '`-p NODE:NAME:=VALUE`, and in a file the key of the node. What is set for all nodes may',
        'be a parameter of another one and is a warning with the closest known name: a file under',
        '`/**`, and `SetParameter` of a launch file that includes one of this package. In a',
        'custom launch file that starts these nodes by itself, `SetParameter` is `-p`: give',
        'what other nodes need in a file under `/**`. Parameters of rclpy (`use_sim_time`,',
        '`start_type_description_service`, `qos_overrides.*`) are known to all nodes.']
    for node in NODES:
        lines += ['', f'## {node}', '', '| name | default | unit | range | meaning |',
                  '|---|---|---|---|---|']
        for row in node_rows(node):
            meaning = row.description + (f' ({_change(row)})' if _change(row) else '')
            lines.append(f'| `{row.name}` | `{yaml_value(row.default)}` | {row.unit} | '
                         f'{row.range_text} | {meaning} |')
    return '\n'.join(lines) + '\n'


def _threshold(check: Check) -> str:
    by_chance = f'{check.probability:.2g}' if check.probability else ''
    if check.dof:
        by_chance += f' (chi-square of {check.dof}: {check.threshold:.3g})'
    return '; '.join(filter(None, (
        by_chance, *(f'{name} {limit:g}' for name, limit in check.limits.items()),
        ', '.join(f'`{name}`' for name in check.options.split(', ') if name),
        f'{check.frames} frames' if check.frames else '')))


def checks_text(page: str) -> str:
    """Return the page of integrity with the table of all checks as it is now."""
    lines = ['| check | evidence | threshold | action | what a user sees |',
             '|---|---|---|---|---|']
    for name, check in CHECKS.items():
        seen = re.sub(r'{.*?}', '…', check.diagnostic) or '—'
        lines.append(f'| {name.lower().replace("_", " ")} | {check.evidence} | '
                     f'{_threshold(check)} | {check.action} | {seen} |')
    head, begin, rest = page.partition(f'<!-- checks: made by {_COMMAND} -->\n')
    _, end, tail = rest.partition('<!-- end of checks -->')
    return f'{head}{begin}\n' + '\n'.join(lines) + f'\n\n{end}{tail}'


def files(root: Path = Path()) -> dict[str, str]:
    """Return the text of every generated file, by its path in the source tree."""
    texts = {f'config/{node}.yaml': yaml_text(node) for node in NODES}
    texts['docs/parameters.md'] = markdown_text()
    integrity = 'docs/integrity.md'
    texts[integrity] = checks_text((root / integrity).read_text())
    return texts


if __name__ == '__main__':
    for path, text in files().items():
        Path(path).write_text(text)
