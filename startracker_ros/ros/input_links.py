# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether the nodes that publish the inputs of a node have discovered its subscriptions."""

import time
from typing import TYPE_CHECKING

from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.task import Future

if TYPE_CHECKING:
    from startracker_ros.ros.node import PipelineNode

_REPEAT_S = 0.5
_LIMIT_S = 10.0


class InputLinks:
    """
    Asks each managed node that publishes an input for its state, until it has answered once.

    Discovery has two directions: on a busy machine a publisher may find a subscription seconds
    after that has found the publisher, and what it publishes until then is lost. A response says
    that the other node has discovered the client. It has then discovered the subscriptions, too:
    a participant announces what it reads in order, and they were created before the client.
    A node that does not answer is waited for no longer than ten seconds.
    """

    def __init__(self, node: 'PipelineNode') -> None:
        self._node = node
        self._clients: dict[str, Client] = {}
        self._requests: dict[str, list[Future]] = {}
        self._due_s: dict[str, float] = {}
        self._begin_s = time.monotonic()

    def are_there(self) -> bool:
        """Return whether all that are known have answered, or the time is over; to be repeated."""
        now_s = time.monotonic()
        missing = self._missing()
        if not missing or now_s > self._begin_s + _LIMIT_S:
            for client in self._clients.values():
                self._node.destroy_client(client)
            return True
        for name in missing:
            # A request, or its response, may have been lost.
            if now_s >= self._due_s[name] and self._clients[name].service_is_ready():
                self._due_s[name] = now_s + _REPEAT_S
                self._requests[name].append(self._clients[name].call_async(GetState.Request()))
        return False

    def _missing(self) -> list[str]:
        """Return the services of the managed nodes that have not answered."""
        for name in self._services() - self._clients.keys():
            self._clients[name] = self._node.create_client(GetState, name)
            self._requests[name], self._due_s[name] = [], 0.0
        return [name for name, requests in self._requests.items()
                if not any(future.done() for future in requests)]

    def _services(self) -> set[str]:
        """Return the services of the other nodes that publish what the node subscribes to."""
        ends = (end for subscription in self._node.subscriptions
                for end in self._node.get_publishers_info_by_topic(subscription.topic_name))
        names = {f'{end.node_namespace.rstrip("/")}/{end.node_name}' for end in ends} - {
            self._node.get_fully_qualified_name()}
        # Those of other nodes, as a camera driver, are not managed.
        return {service for name in names
                if self._node.count_services(service := f'{name}/get_state')}
