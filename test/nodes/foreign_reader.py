# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags as rosbags reads them, without code of this package."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores


def messages_by_topic(bag: Path) -> dict[str, list[Any]]:
    """Return all messages of a bag by topic, in their order."""
    messages = defaultdict(list)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            messages[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    return dict(messages)


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message with a header."""
    return message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec
