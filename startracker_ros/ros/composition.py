# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Several nodes in one process: messages between them go by reference, without DDS."""

from collections import defaultdict, deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.publisher import Publisher
from startracker_ros.ros.messages.serialized import PassedMessage
from startracker_ros.ros.one_call import OneCall
from std_msgs.msg import Header


class IntraProcessPublisher:
    """
    A publisher that delivers messages to the nodes of this process by reference.

    They are published over DDS only where another process subscribes, or where the topic is
    transient local. The nodes of this process receive them first.
    """

    def __init__(self, publisher: Publisher, composition: 'Composition',
                 transient_local: bool) -> None:
        self._publisher = publisher
        self._composition = composition
        self._transient_local = transient_local
        self._topic = publisher.topic_name

    def publish(self, message: Any) -> None:
        """Publish a message, which must not be changed afterwards."""
        external = self._transient_local or self._publisher.get_subscription_count()
        if self._composition.subscription_count(self._topic):
            self._composition.deliver(
                self._topic, message, self._publish_external if external else None)
        elif external:
            self._publish_external(message)

    def publish_value(self, header: Header, value: Any, serialize: Callable[[], bytes]) -> None:
        """Publish a value, of which only other processes need what serialize() returns."""
        self.publish(PassedMessage(self._publisher.msg_type, header, value, serialize))

    def _publish_external(self, message: Any) -> None:
        self._publisher.publish(
            message.serialized if isinstance(message, PassedMessage) else message)

    def get_subscription_count(self) -> int:
        """Return the number of subscriptions, of this process and of others."""
        return (self._composition.subscription_count(self._topic)
                + self._publisher.get_subscription_count())


class Composition:
    """
    The publishers and subscriptions of the nodes of this process, which share one thread.

    A topic that one of the nodes publishes is received from that node only. Messages go through a
    queue, so that a callback returns before what it published is delivered, as over DDS. A
    second queue is for work that the attitude does not depend on; it is processed last.
    one_call is what extractor, tracker and estimator share if all three are in this process.
    """

    def __init__(self) -> None:
        self.one_call = OneCall()
        self._published: set[str] = set()
        self._callbacks: dict[str, list[tuple[Callable[[Any], None], bool]]] = defaultdict(list)
        self._pending: dict[str, list[Callable[[], None]]] | None = defaultdict(list)
        self._first: deque[Callable[[], None]] = deque()
        self._last: deque[Callable[[], None]] = deque()
        self._processing = False

    def advertise(self, publisher: Publisher, transient_local: bool) -> IntraProcessPublisher:
        """Return a publisher to this process and to DDS."""
        self._published.add(publisher.topic_name)
        return IntraProcessPublisher(publisher, self, transient_local)

    def subscribe(self, topic: str, callback: Callable[[Any], None],
                  subscribe_dds: Callable[[], None], last: bool = False) -> None:
        """Subscribe to the node that publishes a topic; call subscribe_dds() if there is none."""
        self._callbacks[topic].append((callback, last))
        if self._pending is not None:
            self._pending[topic].append(subscribe_dds)
        elif topic not in self._published:
            subscribe_dds()

    def connect(self) -> None:
        """Subscribe over DDS to what no node publishes, once all nodes are created."""
        pending, self._pending = self._pending, None
        for topic, subscriptions in (pending or {}).items():
            if topic not in self._published:
                for subscribe_dds in subscriptions:
                    subscribe_dds()

    def subscription_count(self, topic: str) -> int:
        """Return the number of subscriptions of this process."""
        return len(self._callbacks.get(topic, ()))

    def deliver(self, topic: str, message: Any, publish: Callable[[Any], None] | None) -> None:
        """Queue a message for all subscriptions, then for publish()."""
        for callback, last in self._callbacks[topic]:
            (self._last if last else self._first).append(partial(callback, message))
        if publish is not None:
            self._last.append(partial(publish, message))
        self._process()

    def defer(self, work: Callable[[], None]) -> None:
        """Queue work that the attitude does not depend on."""
        self._last.append(work)
        self._process()

    def _process(self) -> None:
        if self._processing:
            return
        self._processing = True
        try:
            while queue := self._first or self._last:
                queue.popleft()()
        finally:
            self._processing = False
            self._first.clear()
            self._last.clear()
