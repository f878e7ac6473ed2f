# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An image from one process to another, for the doctor: send TOPIC, receive TOPIC."""

import json
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message

_IMAGES = 5


def send(topic: str) -> None:
    """Publish an image at 10 Hz until killed."""
    rclpy.init()
    node = Node('startracker_loopback_send')
    publisher = node.create_publisher(Image, topic, qos.IMAGE)
    image = np.zeros((1024, 1024), np.uint16)
    while True:
        publisher.publish(image_to_message(image, make_header(time.time_ns(), 'loopback')))
        rclpy.spin_once(node, timeout_sec=0)
        time.sleep(0.1)


def receive(topic: str) -> None:
    """Print the median transport time of the first images as JSON."""
    rclpy.init()
    node = Node('startracker_loopback_receive')
    times_ms: list[float] = []

    def on_image(message: Image) -> None:
        times_ms.append((time.time_ns() - ns_from_stamp(message.header.stamp)) * 1e-6)
    node.create_subscription(Image, topic, on_image, qos.IMAGE)
    while len(times_ms) < _IMAGES:
        rclpy.spin_once(node)
    print(json.dumps({'median_ms': float(np.median(times_ms))}))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    {'send': send, 'receive': receive}[sys.argv[1]](sys.argv[2])
