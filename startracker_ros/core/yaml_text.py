# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""YAML of unknown origin."""

from pathlib import Path
from typing import Any

import yaml

_MAX_DEPTH = 30
_LARGEST_FILE_BYTES = 1_000_000


def read_yaml(path: str | Path) -> Any:
    """Return the document of a file of at most 1 MB; OSError, ValueError as of load_yaml()."""
    with open(path, 'rb') as file:
        text = file.read(_LARGEST_FILE_BYTES + 1)
    if len(text) > _LARGEST_FILE_BYTES:
        raise ValueError(f'more than {_LARGEST_FILE_BYTES} bytes')
    return load_yaml(text)


def load_yaml(text: str | bytes) -> Any:
    """
    Return the document; ValueError if it is not YAML, has aliases or is nested too deeply.

    Deep nesting crashes libyaml, and aliases expand exponentially; rosbag2 writes neither.
    """
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError('it has aliases')
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            if depth > _MAX_DEPTH:
                raise ValueError(f'it is nested deeper than {_MAX_DEPTH}')
        return yaml.load(text, Loader=yaml.CSafeLoader)
    # A scalar that does not fit its tag raises many kinds: IndexError for an empty !!int.
    except (yaml.YAMLError, ValueError, LookupError, TypeError, OverflowError) as error:
        raise ValueError(f'no YAML: {error}') from error
