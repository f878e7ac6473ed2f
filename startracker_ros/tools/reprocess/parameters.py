# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of a run: those of the nodes, out of YAML files and sweeps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import difflib
from itertools import product
from pathlib import Path
from typing import Any

from startracker_ros.core.stages.parameters import (
    KNOWN, NODES, options_of_nodes, ParameterError, StarTrackerOptions)
from startracker_ros.core.yaml_text import load_yaml


@dataclass(frozen=True)
class ParameterSet:
    """The options of a run; name is empty for the only one, values are those that were set."""

    name: str
    options: StarTrackerOptions
    values: Mapping[str, Any]


def parameter_sets(files: Iterable[Path], settings: Sequence[str]
                   ) -> tuple[list[ParameterSet], list[str]]:
    """
    Return a set for each combination of the settings, and what of the files has no effect.

    files are YAML in the layout of ROS; a setting is NODE.NAME=VALUE[,VALUE...]. ParameterError
    for what is unknown or out of range.
    """
    base: dict[str, Any] = {}
    unused: list[str] = []
    for path in files:
        for name, value in _read(path).items():
            if name in KNOWN:
                base[name] = value
            else:
                unused.append(name)
    swept = dict(_setting(text) for text in settings)
    if len(swept) < len(settings):
        raise ParameterError('a parameter is set twice; write its values as NAME=A,B')
    several = [name for name, values in swept.items() if len(values) > 1]
    sets = []
    for combination in product(*swept.values()):
        chosen = dict(zip(swept, combination))
        name = ','.join(f'{name.partition(".")[2]}={_plain(chosen[name])}' for name in several)
        values = {**base, **chosen}
        sets.append(ParameterSet(name, options_of_nodes(values), values))
    if len({item.name for item in sets}) < len(sets):
        raise ParameterError('two values of a sweep are the same')
    return sets, unused


def _setting(text: str) -> tuple[str, list[Any]]:
    name, equals, value = text.partition('=')
    if not equals:
        raise ParameterError(f'--set {text} is not NODE.NAME=VALUE[,VALUE...]')
    if name not in KNOWN:
        near = difflib.get_close_matches(name, KNOWN, 1)
        hint = f'; did you mean {near[0]}?' if near else f'; nodes: {", ".join(NODES)}'
        raise ParameterError(f'unknown parameter {name}{hint}')
    try:
        values = load_yaml(f'[{value}]'.encode())
    except ValueError as error:
        raise ParameterError(f'--set {text}: {error}') from error
    if not isinstance(values, list) or not values:
        raise ParameterError(f'--set {text} has no value')
    return name, values


def _read(path: Path) -> dict[str, Any]:
    """Return NODE.NAME and value of a YAML file."""
    try:
        document = load_yaml(path.read_bytes())
    except (OSError, ValueError) as error:
        raise ParameterError(f'{path}: {error}') from error
    if not isinstance(document, dict):
        raise ParameterError(f'{path} holds no parameters')
    found: dict[str, Any] = {}
    for node, content in document.items():
        values = content.get('ros__parameters') if isinstance(content, dict) else None
        if not isinstance(values, dict):
            raise ParameterError(f'{path}: {node} has no ros__parameters')
        found |= {f'{str(node).rpartition("/")[2]}.{name}': value
                  for name, value in values.items()}
    return found


def _plain(value: Any) -> str:
    """Return a value as part of the name of a folder."""
    return str(value).replace('/', '_').replace(' ', '')
