# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Message types by their names."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
import re

_TYPE_NAME = re.compile('([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)')


def message_class(type_name: str) -> type:
    """
    Return the class of a name like sensor_msgs/msg/Image; ImportError if not installed.

    Names come out of bags and from other processes, and importing runs code: only packages
    that were generated from message definitions are imported.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise ImportError(f'{type_name!r} is not the name of a message type')
    package, kind, name = match.groups()
    spec = find_spec(package)
    folders = spec.submodule_search_locations if spec is not None else None
    if not any(any(Path(folder).glob(f'{package}_s__rosidl_typesupport_c*'))
               for folder in folders or ()):
        raise ImportError(f'{package} is not an installed message package')
    try:
        return getattr(import_module(f'{package}.{kind}'), name)
    except AttributeError as error:
        raise ImportError(f'{package} has no message {name}') from error
