# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slow subscriber: subscribes reliably to TOPIC:TYPE... and sleeps over each message."""

import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from startracker_ros.ros.messages.message_types import message_class

_SLEEP_S = 5.0
_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)


def main(topics: list[str]) -> None:
    """Subscribe until killed."""
    rclpy.init()
    node = Node('startracker_slow_consumer')
    for topic, _, type_name in (word.partition(':') for word in topics):
        node.create_subscription(message_class(type_name), topic,
                                 lambda message: time.sleep(_SLEEP_S), _ALL)
    rclpy.spin(node)


if __name__ == '__main__':
    main(sys.argv[1:])
