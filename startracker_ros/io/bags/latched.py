# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What latched (transient local) topics held at a time of a recording."""

from collections import deque
from collections.abc import Iterable

from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import BagMessage

MAX_DEPTH = 10_000
"""Messages of a topic, whatever its publishers offered."""

# Unfinished bags are read in the order of writing, which is nearly that of time.
DISORDER_NS = 10 ** 9


def held_messages(offers: Iterable[QosProfile]) -> int:
    """
    Return how many messages the publishers of a topic hold for late subscribers.

    A recorder does not know the depth of a publisher over DDS: one message is assumed.
    """
    latched = [offer for offer in offers if offer.durability == 'transient_local']
    return min(MAX_DEPTH, sum(
        MAX_DEPTH if offer.history == 'keep_all' else max(1, offer.depth) for offer in latched))


def held_before(messages: Iterable[BagMessage], held: dict[str, int], time_ns: int
                ) -> list[BagMessage]:
    """Return the last messages before a log time, held[topic] of each topic, oldest first."""
    last: dict[str, deque[BagMessage]] = {
        topic: deque(maxlen=count) for topic, count in held.items()}
    for message in messages:
        if message.log_time_ns >= time_ns + DISORDER_NS:
            break
        if message.log_time_ns < time_ns:
            last[message.topic].append(message)
    return sorted((message for some in last.values() for message in some),
                  key=lambda message: message.log_time_ns)
