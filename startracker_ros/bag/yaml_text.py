"""YAML of unknown origin."""

from typing import Any

import yaml

_MAX_DEPTH = 30


def load_yaml(text: str | bytes) -> Any:
    """
    Return the document; ValueError if it is no YAML, has aliases or is nested too deeply.

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
