# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Plays the inputs of a bag as `ros2 bag play --clock` does, without code of the package's nodes.

`python replaying.py BAG RATE EARLY`: publishers with the recorded quality of service; the first
message goes out when their subscribers are matched, whatever these do. EARLY images come before
the first camera_info.
"""

from pathlib import Path
import sys
from threading import Event, Thread
import time

import rclpy
from rosgraph_msgs.msg import Clock
from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.ros.bag_qos import playback_qos
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.message_types import message_class

INPUTS = ('/image_raw', '/camera_info', '/imu', '/odometry')
# Stages that subscribe to each, at least.
SUBSCRIBERS = {'/image_raw': 1, '/camera_info': 4, '/imu': 1, '/odometry': 2}
DISCOVERY_S = 0.5
CLOCK_S = 1.0 / 40.0


def main(bag: Path, rate: float, early: int) -> None:
    rclpy.init()
    node = rclpy.create_node('replaying')
    publishers = {topic.name: node.create_publisher(
        message_class(topic.type_name), topic.name, playback_qos(topic.qos))
        for topic in read_topics(bag).values() if topic.name in INPUTS}
    messages = list(read_messages(bag, topics=INPUTS))
    images = [message.log_time_ns for message in messages if message.topic == '/image_raw']
    messages = [message for message in messages if message.topic != '/camera_info'
                or not early or message.log_time_ns > images[early - 1]]
    while any(publisher.get_subscription_count() < SUBSCRIBERS[name]
              for name, publisher in publishers.items()):
        time.sleep(0.01)
    time.sleep(DISCOVERY_S)
    begin_s, begin_ns = time.monotonic(), messages[0].log_time_ns
    clock, ended = node.create_publisher(Clock, '/clock', 10), Event()

    def publish_clock() -> None:
        while not ended.wait(CLOCK_S):
            clock.publish(Clock(clock=stamp_from_ns(
                begin_ns + int((time.monotonic() - begin_s) * rate * 1e9))))
    clock_thread = Thread(target=publish_clock)
    clock_thread.start()
    for message in messages:
        due_s = begin_s + (message.log_time_ns - begin_ns) * 1e-9 / rate
        time.sleep(max(0.0, due_s - time.monotonic()))
        publishers[message.topic].publish(message.data)
    for publisher in publishers.values():
        publisher.wait_for_all_acked()
    ended.set()
    clock_thread.join(DISCOVERY_S)


if __name__ == '__main__':
    main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
