# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contents of a bag as rows."""

from datetime import datetime, UTC
from pathlib import Path

from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.folder import BagFiles, find_files
from startracker_ros.io.bags.reader import (
    BagTopic, open_file, read_rates_hz, read_span_ns, read_topics)
from startracker_ros.io.bags.remote import version
from startracker_ros.io.table import Result


def describe(bag: Path) -> tuple[Result, list[str]]:
    """
    Return a row for each topic, and the problems of the bag; BagError if it is not a bag.

    A sound index is used alone; otherwise every message is read.
    """
    problems: list[str] = []
    try:
        topics = read_topics(bag)
    except BagError:
        topics = read_topics(bag, tolerant=True, report=problems.append)
        if not problems:
            # Only the index is wrong.
            problems = [f'{bag} is damaged, all its messages can be read']
    span_ns = read_span_ns(bag)
    bag_files = find_files(bag, problems.append if problems else None)
    files = bag_files.paths
    duration_s = (span_ns[1] - span_ns[0]) * 1e-9 if span_ns else 0.0
    rates_hz = read_rates_hz(bag)
    rows = [_row(topic, rates_hz.get(topic.name)) for topic in sorted(
        topics.values(), key=lambda topic: topic.name)]
    return Result('info', rows, {
        'files': ', '.join(file.name for file in files),
        'size_mb': sum(version(file)[0] for file in files) / 1e6,
        'compression': _compression(bag_files),
        'messages': sum(topic.message_count for topic in topics.values()),
        'start': _utc(span_ns[0]) if span_ns else '-',
        'duration_s': duration_s,
        'whole': not problems}), problems


def _row(topic: BagTopic, rate_hz: float | None) -> dict[str, object]:
    return {'topic': topic.name, 'type': topic.type_name or topic.encoding,
            'messages': topic.message_count,
            'rate_hz': rate_hz,
            'qos': '; '.join(dict.fromkeys(
                f'{profile.reliability}, {profile.durability}' for profile in topic.qos))}


def _compression(files: BagFiles) -> str:
    """Return what chunks, or single messages or whole files by rosbag2, are compressed with."""
    if files.message_compression:
        return f'{files.message_compression}, each message'
    names: set[str] = set()
    for path in files.paths:
        with open_file(path) as file:
            if file.compressed_file:
                return 'zstd, whole files'
            names |= file.compressions
    return ', '.join(sorted(name or 'none' for name in names)) or 'none'


def _utc(stamp_ns: int) -> str:
    # In integers: a float of the full time resolves a quarter of a microsecond.
    seconds, nanoseconds = divmod(stamp_ns, 10 ** 9)
    try:
        moment = datetime.fromtimestamp(seconds, UTC)
    except (ValueError, OverflowError, OSError):
        return f'{stamp_ns} ns'
    return f'{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d} UTC'
