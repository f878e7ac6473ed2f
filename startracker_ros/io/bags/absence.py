# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Why a bag gives nothing: the one text of all commands that get no rows out of one."""

from collections.abc import Mapping

from startracker_ros.io.bags.patterns import matches
from startracker_ros.io.bags.reader import BagTopic

_LISTED = 10


def why_nothing(topics: Mapping[str, BagTopic], wanted: Mapping[str, str]) -> str:
    """Return why a bag holds none of the wanted messages, as missing() does, and what it holds."""
    return f'{missing(topics, wanted)}; {contents(topics)}'


def missing(topics: Mapping[str, BagTopic], wanted: Mapping[str, str]) -> str:
    """
    Return which of the wanted topics a bag does not have, or without messages of their type.

    wanted: types by full name or pattern of it, '' for any type.
    """
    reasons, absent = [], []
    for pattern, type_name in wanted.items():
        found = [topic for name, topic in sorted(topics.items()) if matches(name, (pattern,))]
        if not found:
            absent.append(pattern)
        for topic in found[:_LISTED]:
            if type_name not in ('', topic.type_name):
                reasons.append(f'{topic.name} is {topic.type_name or topic.encoding}, '
                               f'not {type_name}')
            elif not topic.message_count:
                reasons.append(f'{topic.name} has no messages')
    if absent:
        reasons.append(f'no {", ".join(absent)}')
    return '; '.join(reasons)


def contents(topics: Mapping[str, BagTopic]) -> str:
    """Return the number of messages of a bag, and their topics."""
    names = sorted(name for name, topic in topics.items() if topic.message_count)
    if not names:
        return 'the bag holds no messages'
    more = f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''
    return (f'the bag holds {sum(topic.message_count for topic in topics.values())} messages of '
            f'{", ".join(names[:_LISTED])}{more}')
