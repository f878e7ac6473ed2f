# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Publishers whose quality of service keeps a subscription from receiving anything."""

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from startracker_ros.ros.diagnostics import Diagnostics


class IncompatiblePublishers:
    """Reports, as long as they are there, best effort publishers of reliable subscriptions."""

    def __init__(self, node: Node, diagnostics: Diagnostics) -> None:
        self._node = node
        self._diagnostics = diagnostics
        self._topics: set[str] = set()
        diagnostics.checks.append(self._check)

    def callbacks(self, topic: str) -> SubscriptionEventCallbacks:
        """Return the callbacks of the subscription of a topic."""
        name = self._node.resolve_topic_name(topic)
        return SubscriptionEventCallbacks(incompatible_qos=lambda info: self._topics.add(name))

    def _check(self) -> None:
        topics = [topic for topic in sorted(self._topics) if any(
            offer.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            for offer in self._node.get_publishers_info_by_topic(topic))]
        if topics:
            names = ', '.join(f'qos_overrides.{topic}.subscription.reliability'
                              for topic in topics)
            self._diagnostics.report_event(
                f'nothing is received from best effort publishers: set {names} to best_effort')
