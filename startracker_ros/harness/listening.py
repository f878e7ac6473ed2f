"""What a camera publishes, heard for some seconds and printed as JSON, for the doctor."""

from dataclasses import asdict
import json
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from startracker_ros.bag.layouts import (
    camera_from_message, image_from_message, MessageError, ns_from_stamp)
from startracker_ros.camera.model import CameraError

# Hears reliable and best-effort cameras alike.
_ANY = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)


class Listener(Node):
    """Keeps the newest camera_info and image_raw, and the stamps of all images."""

    def __init__(self, namespace: str) -> None:
        super().__init__('startracker_doctor', namespace=namespace)
        self.heard: dict[str, dict] = {'camera_info': {'count': 0}, 'image_raw': {'count': 0}}
        self._stamps_ns: list[int] = []
        self.create_subscription(CameraInfo, 'camera_info', self._take_camera, _ANY)
        self.create_subscription(Image, 'image_raw', self._take_image, _ANY)

    def _take_camera(self, message: CameraInfo) -> None:
        heard = self.heard['camera_info']
        heard.update(count=heard['count'] + 1, frame_id=message.header.frame_id,
                     camera=None, error='')
        try:
            heard['camera'] = asdict(camera_from_message(message))
        except CameraError as error:
            heard['error'] = str(error)

    def _take_image(self, message: Image) -> None:
        heard = self.heard['image_raw']
        self._stamps_ns.append(ns_from_stamp(message.header.stamp))
        heard.update(count=heard['count'] + 1, frame_id=message.header.frame_id,
                     width=message.width, height=message.height, encoding=message.encoding,
                     error='')
        try:
            image = image_from_message(message)
        except MessageError as error:
            heard['error'] = str(error)
            return
        brightest = int(image.max())
        heard.update(median_dn=float(np.median(image)), max_dn=brightest,
                     brightest_share=float(np.mean(image == brightest)))

    def summary(self) -> dict[str, dict]:
        """Return what was heard, with the offers of the publishers."""
        for topic, heard in self.heard.items():
            offers = self.get_publishers_info_by_topic(topic)
            heard['publishers'] = len(offers)
            heard['best_effort'] = any(
                offer.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                for offer in offers)
        self.heard['image_raw']['stamps_ns'] = self._stamps_ns
        return self.heard


def main(seconds: float, namespace: str) -> None:
    """Listen, then print."""
    rclpy.init()
    node = Listener(namespace)
    deadline_s = time.monotonic() + seconds
    while time.monotonic() < deadline_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(node.summary()))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(float(sys.argv[1]), sys.argv[2])
