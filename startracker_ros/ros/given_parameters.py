"""Which parameters the arguments of a process set for a node by its own name."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

_VALUES = 'ros__parameters'


def addressed_parameters(arguments: Sequence[str], node: str) -> set[str]:
    """
    Return the parameters that are set by -p, or in a parameter file under the name of the node.

    What a file sets for all nodes, under a key as /**, is not among them. rcl has read the files
    before: they exist and are valid.
    """
    names = set()
    for option, value in pairwise(arguments):
        if option in ('-p', '--param'):
            # NAME:=VALUE or NODE:NAME:=VALUE
            owner, _, name = value.partition(':=')[0].rpartition(':')
            names |= {name} if owner in ('', node) else set()
        elif option == '--params-file':
            for key, values in _sections(yaml.safe_load(Path(value).read_text())):
                names |= set(_flat_names(values)) if key.rpartition('/')[2] == node else set()
    return names


def _sections(tree: Any, key: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the keys of a parameter file, which may be nested, with their parameters."""
    for name, below in tree.items() if isinstance(tree, Mapping) else ():
        if name == _VALUES:
            yield key, below
        else:
            yield from _sections(below, f'{key}/{name}')


def _flat_names(tree: Any, prefix: str = '') -> Iterator[str]:
    """Yield the names of parameters, those of groups joined by dots."""
    for name, below in tree.items() if isinstance(tree, Mapping) else ():
        if isinstance(below, Mapping):
            yield from _flat_names(below, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}'
