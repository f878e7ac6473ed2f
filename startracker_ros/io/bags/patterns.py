# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Patterns of topic names."""

from collections.abc import Sequence
from fnmatch import fnmatchcase


def matches(topic: str, patterns: Sequence[str]) -> bool:
    """
    Return whether a full topic name fits one of the patterns, * for any characters.

    The slash before a pattern may be left out.
    """
    return any(fnmatchcase(topic, pattern if pattern[:1] in '/*' else f'/{pattern}')
               for pattern in patterns)


def selected(topic: str, patterns: Sequence[str], exclude: Sequence[str]) -> bool:
    """Return whether a topic matches one of the patterns and none of those to exclude."""
    return matches(topic, patterns) and not matches(topic, exclude)
