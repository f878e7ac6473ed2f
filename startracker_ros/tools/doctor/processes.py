# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Processes of the doctor: `listen SECONDS NAMESPACE` to a camera, `send` and `receive TOPIC`."""

from collections.abc import Callable
from dataclasses import asdict
import json
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from startracker_ros.core.camera.model import CameraError
from startracker_ros.io.bags.layouts import (
    camera_from_message, image_from_message, MessageError, ns_from_stamp, sensor_from_message)
from startracker_ros.ros import qos
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.ros.probe import Probe

# Matches reliable and best-effort publishers.
_ANY = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)


class CameraListener(Probe):
    """Keeps figures of the newest camera_info and image_raw, and the stamps of all images."""

    def __init__(self, namespace: str) -> None:
        super().__init__('startracker_doctor', namespace=namespace)
        self._figures: dict[str, dict] = {'camera_info': {'count': 0}, 'image_raw': {'count': 0}}
        self._stamps_ns: list[int] = []
        self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, _ANY)
        self.create_subscription(Image, 'image_raw', self._on_image, _ANY)

    def _on_camera_info(self, message: CameraInfo) -> None:
        figures = self._figures['camera_info']
        figures.update(count=figures['count'] + 1, frame_id=message.header.frame_id,
                       camera=None, sensor=None, error='')
        try:
            figures['camera'] = asdict(camera_from_message(message))
            figures['sensor'] = asdict(sensor_from_message(message))
        except CameraError as error:
            figures['error'] = str(error)

    def _on_image(self, message: Image) -> None:
        figures = self._figures['image_raw']
        self._stamps_ns.append(ns_from_stamp(message.header.stamp))
        figures.update(count=figures['count'] + 1, frame_id=message.header.frame_id,
                       width=message.width, height=message.height, encoding=message.encoding,
                       error='')
        try:
            image = image_from_message(message).pixels
        except MessageError as error:
            figures['error'] = str(error)
            return
        brightest = int(image.max())
        figures.update(median_dn=float(np.median(image)), max_dn=brightest,
                       brightest_share=float(np.mean(image == brightest)))

    def summary(self) -> dict[str, dict]:
        """Return the figures by topic, with the QoS offered by the publishers."""
        for topic, figures in self._figures.items():
            offers = self.get_publishers_info_by_topic(topic)
            figures['publishers'] = len(offers)
            figures['best_effort'] = any(
                offer.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                for offer in offers)
        self._figures['image_raw']['stamps_ns'] = self._stamps_ns
        return self._figures


def listen(seconds: str, namespace: str) -> None:
    """Print as JSON what a camera publishes within some seconds."""
    rclpy.init()
    listener = CameraListener(namespace)
    listener.spin_for(float(seconds))
    print(json.dumps(listener.summary()))
    listener.destroy_node()
    rclpy.shutdown()


# --- an image from one process to another ---

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
    commands: dict[str, Callable[..., None]] = {
        'listen': listen, 'send': send, 'receive': receive}
    commands[sys.argv[1]](*sys.argv[2:])
