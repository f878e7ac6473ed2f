# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What late subscribers of a recorded time would have received."""

from startracker_ros.io.bags.playback import DISORDER_NS, held_before, held_messages
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import BagMessage
from startracker_ros.ros.bag_qos import playback_qos


def offer(**values):
    return QosProfile(durability='transient_local', **values)


def message(topic, time_ns):
    return BagMessage(topic, 'std_msgs/msg/String', b'', time_ns, 0)


def times(found):
    return [(one.topic, one.log_time_ns) for one in found]


def test_each_publisher_holds_its_depth_or_one_message():
    assert held_messages([]) == held_messages([QosProfile(depth=5)]) == 0
    assert held_messages([offer()] * 3) == 3
    assert held_messages([offer(history='keep_last', depth=7), QosProfile(depth=9)]) == 7
    assert held_messages([offer(history='keep_all')] * 2) == 10_000
    # One publisher plays what several have held.
    one = offer(history='keep_last', depth=1)
    assert playback_qos([one, one, one]).depth == 3
    assert playback_qos([QosProfile(history='keep_last', depth=1)] * 3).depth == 1


def test_the_last_messages_of_each_topic_before_the_time_in_order():
    recorded = [message('/a', 1), message('/b', 2), message('/a', 3), message('/a', 4),
                message('/a', 5), message('/b', 6)]
    assert times(held_before(recorded, {'/a': 2, '/b': 1}, 5)) == [('/b', 2), ('/a', 3), ('/a', 4)]
    assert held_before(recorded, {'/a': 2, '/b': 1}, 1) == []


def test_reading_ends_after_the_time_also_where_the_order_is_that_of_writing():
    read = []

    def recorded():
        for time_ns in (1, 5 + DISORDER_NS // 2, 4, 5 + DISORDER_NS, 2):
            read.append(time_ns)
            yield message('/a', time_ns)
    assert times(held_before(recorded(), {'/a': 9}, 5)) == [('/a', 1), ('/a', 4)]
    assert read[-1] == 5 + DISORDER_NS
