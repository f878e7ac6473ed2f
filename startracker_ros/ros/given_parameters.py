# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which parameters the arguments of a process set for its nodes, and not for all nodes."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
import os
from pathlib import Path

import yaml

LAUNCHED = 'STARTRACKER_LAUNCHED'
"""Set in the environment of nodes that a launch file of this package starts."""

_VALUES = 'ros__parameters'


def addressed_parameters(arguments: Sequence[str], node: str) -> set[str]:
    """
    Return the parameters that are set by -p, or in a file under the name of the node.

    What is set for all nodes, under a key as /**, is not among them. Nor is -p NAME:=VALUE without
    the name of a node where launch has started it: SetParameter of any launch file comes so. rcl
    has read the files before: they exist and are valid.
    """
    owners = {node} if os.environ.get(LAUNCHED) else {node, ''}
    names = set()
    for option, value in pairwise(arguments):
        if option in ('-p', '--param'):
            owner, _, name = value.partition(':=')[0].rpartition(':')
            names |= {name} if owner in owners else set()
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
