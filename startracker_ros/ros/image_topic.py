# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The topic of the images: raw, or compressed as the transports of image_transport."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import image_from_message, StarImage
from startracker_ros.ros import qos
from startracker_ros.ros.memory import profile_variable
from startracker_ros.ros.messages.compressed_image import (
    image_from_compressed, image_to_compressed)
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.ros.node import PipelineNode
from std_msgs.msg import Header


@dataclass(frozen=True)
class TransportOptions(Options):
    """How images are sent."""

    image_transport: str = option(
        'raw', 'raw: images are on image_raw; compressed: on image_raw/compressed, as PNG without '
        'loss', choices=('raw', 'compressed'), read_only=True)

    @property
    def is_compressed(self) -> bool:
        """Return whether images are compressed."""
        return self.image_transport == 'compressed'

    @property
    def topic(self) -> str:
        """Return the topic of the images."""
        return 'image_raw/compressed' if self.is_compressed else 'image_raw'


class ImageOutput:
    """Publishes images (H, W) by the transport of the node's options."""

    def __init__(self, node: PipelineNode) -> None:
        options = node.options(TransportOptions)
        message_type, self._message = ((CompressedImage, image_to_compressed)
                                       if options.is_compressed else (Image, image_to_message))
        self._publisher: Publisher = node.advertise(message_type, options.topic, qos.IMAGE)

    @property
    def subscriptions(self) -> int:
        """Return the number of matched subscriptions."""
        return self._publisher.get_subscription_count()

    def publish(self, image: np.ndarray, header: Header) -> None:
        """Publish an image (H, W) uint8 or uint16."""
        self._publisher.publish(self._message(image, header))


def subscribe_images(node: PipelineNode, on_image: Callable[[StarImage, Header], None]) -> None:
    """Call on_image() with each image and its header; messages that hold none are named."""
    options = node.options(TransportOptions)
    if options.is_compressed:
        node.subscribe(CompressedImage, options.topic, lambda message: on_image(
            StarImage(image_from_compressed(message)), message.header), qos.IMAGE)
    else:
        node.subscribe(Image, options.topic, lambda message: on_image(
            image_from_message(message), message.header), qos.IMAGE)


def why_images_are_missing(node: PipelineNode) -> str:
    """Return what to do where images are subscribed to with best effort, otherwise nothing."""
    name = node.resolve_topic_name(node.options(TransportOptions).topic)
    if any(subscription.topic_name == name
           and subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
           for subscription in node.subscriptions):
        return (': with best effort the default shared memory of Fast DDS loses most images: '
                f'start the camera with {profile_variable()} set to config/fastdds.xml of '
                'startracker_ros, or reliable on both sides')
    return ''
