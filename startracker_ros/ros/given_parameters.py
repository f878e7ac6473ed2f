# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which parameters the arguments of a process set for a node by its own name."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import yaml

_VALUES = 'ros__parameters'


def addressed_parameters(arguments: Sequence[str], node: str) -> set[str]:
    """
    Return the parameters that are set by -p NODE:NAME:=VALUE or in a file under the node's name.

    What is set for all nodes, by -p NAME:=VALUE or under a key as /**, is not among them. rcl has
    read the files before: they exist and are valid.
    """
    names = set()
    for option, value in pairwise(arguments):
        if option in ('-p', '--param'):
            owner, _, name = value.partition(':=')[0].rpartition(':')
            names |= {name} if owner == node else set()
        elif option == '--params-file':
            for key, parameters in sections(Path(value)):
                names |= parameters if key.rpartition('/')[2] == node else set()
    return names


def sections(path: Path) -> Iterator[tuple[str, set[str]]]:
    """Yield the keys of a parameter file, which may be nested, with the names below each."""
    # The nodes of YAML instead of values, as launch_ros writes tags of Python.
    yield from _sections(yaml.compose(path.read_text(), yaml.SafeLoader), '')


def _sections(node: yaml.Node | None, key: str) -> Iterator[tuple[str, set[str]]]:
    for name, below in _items(node):
        if name == _VALUES:
            yield key, set(_names(below, ''))
        else:
            yield from _sections(below, f'{key}/{name}')


def _names(node: yaml.Node, prefix: str) -> Iterator[str]:
    """Yield the names of parameters, those of groups joined by dots."""
    for name, below in _items(node):
        if isinstance(below, yaml.MappingNode):
            yield from _names(below, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}'


def _items(node: yaml.Node | None) -> list[tuple[str, yaml.Node]]:
    if not isinstance(node, yaml.MappingNode):
        return []
    return [(name.value, below) for name, below in node.value]
