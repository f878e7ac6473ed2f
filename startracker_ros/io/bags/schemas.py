# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Definition and hash of an installed message type, as a bag stores them."""

from dataclasses import dataclass
import json
import os
from pathlib import Path
import re
import sys

_TYPE_NAME = re.compile(r'([a-zA-Z0-9_]+)/(?:msg/)?([a-zA-Z0-9_]+)')
_PRIMITIVES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))
_SEPARATOR = '\n' + '=' * 80 + '\nMSG: '


@dataclass(frozen=True)
class MessageSchema:
    """Definition of a type; encoding, text and type_hash are empty where nothing is installed."""

    encoding: str
    text: str
    type_hash: str


def message_schema(type_name: str) -> MessageSchema:
    """
    Return the schema of a type like 'sensor_msgs/msg/Image'.

    As in rosbag2, the text is the .msg file followed by those of all types in it, depth
    first and in the order of their names, and a type that is not found, or one of whose
    parts is not found, gets an empty schema: its messages can be recorded all the same.
    The hash is the one of the installed type description (REP 2016).
    """
    try:
        return MessageSchema('ros2msg', _full_text(type_name, {type_name}), _type_hash(type_name))
    except FileNotFoundError:
        return MessageSchema('', '', '')


def _full_text(type_name: str, seen: set[str]) -> str:
    """Return the definition with what it needs; types in seen are left out and added to it."""
    package = type_name.split('/')[0]
    text = _type_file(type_name, '.msg').read_text()
    parts = [text]
    for dependency in sorted(_dependencies(text, package)):
        if dependency not in seen:
            seen.add(dependency)
            parts.append(f'{_SEPARATOR}{dependency}\n{_full_text(dependency, seen)}')
    return ''.join(parts)


def _dependencies(text: str, package: str) -> set[str]:
    """Return the types of the fields that are messages themselves, as 'package/Type'."""
    names = set()
    for line in text.splitlines():
        words = line.split('#')[0].split()
        name = re.split(r'[\[<]', words[0])[0] if words else ''
        if name and name not in _PRIMITIVES:
            names.add(name if '/' in name else f'{package}/{name}')
    return names


def _type_hash(type_name: str) -> str:
    try:
        description = json.loads(_type_file(type_name, '.json').read_text())
    except FileNotFoundError:
        return ''
    return next(entry['hash_string'] for entry in description['type_hashes']
                if entry['type_name'] == type_name)


def _type_file(type_name: str, suffix: str) -> Path:
    """Return a file of rosidl's from share/<package>/msg; FileNotFoundError if none is there."""
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise FileNotFoundError(f'{type_name} is not the name of a message type')
    package, name = match.groups()
    # The overlays in their order, then the environment of this interpreter (ROS from wheels).
    prefixes = [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)),
                sys.prefix]
    for prefix in prefixes:
        path = Path(prefix, 'share', package, 'msg', name + suffix)
        if path.is_file():
            return path
    raise FileNotFoundError(f'{type_name} is not installed')
