# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Wait of a player for the subscribers of its topics."""

from collections.abc import Mapping
import time

from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo
from startracker_ros.io.bags.playback import PlayOptions
from startracker_ros.ros.node import PipelineNode


class AwaitedSubscribers:
    """The subscribers that a player waits for, from now until the limit of its options."""

    def __init__(self, publishers: Mapping[str, Publisher], options: PlayOptions,
                 node: PipelineNode) -> None:
        self._publishers = publishers
        self._options = options
        self._node = node
        self._limit_s = time.monotonic() + options.wait_limit_s
        self._begin_s: float | None = None

    def are_there(self) -> bool:
        """Return whether to begin: all are matched or the limit is over, and the delay as well."""
        now_s = time.monotonic()
        if self._begin_s is None:
            missing = self._missing()
            if missing and now_s < self._limit_s:
                self._node.diagnostics.report_event(
                    f'waiting for subscribers of {", ".join(missing)}', expected=True)
                return False
            self._begin_s = now_s + self._options.start_delay_s
            if missing:
                self._node.get_logger().warning(
                    f'played without all subscribers of {", ".join(missing)}')
        return now_s >= self._begin_s

    def _missing(self) -> list[str]:
        """Return the topics with fewer matched subscribers than the options name."""
        return [publisher.topic_name for publisher in self._publishers.values()
                if publisher.get_subscription_count() < self._needed(publisher)]

    def _needed(self, publisher: Publisher) -> int:
        options = self._options
        return max(options.wait_for_subscribers,
                   options.wait_for_camera_users if publisher.msg_type is CameraInfo else 0)
