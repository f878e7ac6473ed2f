# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recovers a damaged or unfinished bag into a new one."""

from collections.abc import Callable
from pathlib import Path

from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.bags.writer import BagWriter


def recover(bag: Path, folder: Path, *, report: Callable[[str], None]) -> int:
    """
    Write every intact message of a bag into a new bag; return their number.

    Definitions, hashes and quality of service are copied. report() is called with each damage.
    BagError if the old bag cannot be read at all, or the new one cannot be written.
    """
    topics = read_topics(bag, tolerant=True)
    count = 0
    with BagWriter(folder) as writer:
        for topic in topics.values():
            writer.add_topic(topic.name, topic.type_name, topic.qos, schema=topic.schema,
                             encoding=topic.encoding)
        for message in read_messages(bag, tolerant=True, report=report):
            writer.write(message.topic, message.data, message.log_time_ns,
                         message.publish_time_ns)
            count += 1
    return count
