# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node that observes others: collects messages by topic, publishes, calls services, waits."""

from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from startracker_ros.ros.processes import HarnessError

_SPIN_S = 0.05
_DISCOVERY_S = 0.3
_REPEAT_REQUEST_S = 3.0
_REPEAT_MESSAGE_S = 1.0
_DEPTH = 1000
"""Of what a probe receives: on a busy machine it may not run for seconds."""


@dataclass(frozen=True)
class Diagnostic:
    """A status of /diagnostics and when it was received (monotonic clock)."""

    received_s: float
    status: DiagnosticStatus

    @property
    def node(self) -> str:
        """Return the name of the node, the part of the status name before the colon."""
        return self.status.name.partition(':')[0]


class Progress:
    """Measures how long a value has not changed."""

    def __init__(self, stall_s: float) -> None:
        self._value: object = None
        self._stall_s = stall_s
        self._changed_s = time.monotonic()

    def is_stalled(self, value: object) -> bool:
        """Return whether the value has not changed for stall_s."""
        if value != self._value:
            self._value, self._changed_s = value, time.monotonic()
        return time.monotonic() - self._changed_s > self._stall_s


def _deep(profile: QoSProfile | int) -> QoSProfile:
    """Return a profile, or one of a depth, that holds all that comes while a probe is busy."""
    deep = QoSProfile(depth=profile) if isinstance(profile, int) else copy(profile)
    deep.depth = max(deep.depth, _DEPTH)
    return deep


class Probe(Node):
    """
    Collects messages by topic, publishes, calls services and waits with a deadline.

    requests counts the requests by service, those that were repeated included.

    HarnessError when a wait exceeds its time limit, timeout_s by default; the text names
    log_folder.
    """

    def __init__(self, name: str, *, context: Context | None = None, namespace: str = '',
                 timeout_s: float = 30.0, log_folder: Path | None = None) -> None:
        super().__init__(name, context=context, namespace=namespace)
        self.received: dict[str, list[Any]] = defaultdict(list)
        self.diagnostics: list[Diagnostic] = []
        self.requests: Counter[str] = Counter()
        self._timeout_s = timeout_s
        self._log_folder = log_folder
        self._service_clients: dict[str, Client] = {}
        self._spinner = SingleThreadedExecutor(context=context)
        self._spinner.add_node(self)

    def destroy_node(self) -> None:
        """Remove the node from its executor and from DDS."""
        self._spinner.remove_node(self)
        self._spinner.shutdown()
        super().destroy_node()

    # --- messages and services ---

    def collect(self, message_type: type, topic: str, profile: Any = 10) -> None:
        """Append every message of a topic to received[topic], whatever the depth of a profile."""
        self.create_subscription(message_type, topic, self.received[topic].append,
                                 _deep(profile))

    def subscribe_with_info(self, message_type: type, topic: str,
                            callback: Callable[[Any, dict[str, int]], None], profile: Any
                            ) -> None:
        """Call back with each message and its source_timestamp and received_timestamp, in ns."""
        # The type hint of rclpy allows callbacks of one argument only.
        self.create_subscription(
            message_type, topic, callback, _deep(profile))  # type: ignore[arg-type]

    def collect_diagnostics(self) -> None:
        """Append every message of /diagnostics to received, and each status to diagnostics."""
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, _DEPTH)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.received['/diagnostics'].append(message)
        now_s = time.monotonic()
        self.diagnostics += [Diagnostic(now_s, status) for status in message.status]

    def forget(self) -> None:
        """Delete what was received, to observe the same nodes again."""
        for messages in self.received.values():
            messages.clear()
        self.diagnostics.clear()

    def advertise(self, message_type: type, topic: str, profile: Any = 10, *,
                  subscribers: int = 1) -> Publisher:
        """Return a publisher once that many subscribers match."""
        publisher = self.create_publisher(message_type, topic, profile)
        self.wait(lambda: publisher.get_subscription_count() >= subscribers,
                  f'{subscribers} subscribers of {topic}')
        # The match on the side of the subscriber may come a little later.
        self.spin_for(_DISCOVERY_S)
        return publisher

    def send_until(self, send: Callable[[], Any], condition: Callable[[], Any], what: str, *,
                   period_s: float = _REPEAT_MESSAGE_S, timeout_s: float | None = None) -> Any:
        """
        Send now and every period_s until a condition is true, and return its value.

        One message may be too early, in the wrong order among several topics, or too late in a
        short queue. What is sent again has a new stamp where the receiver drops old ones.
        """
        due_s = 0.0

        def sent_and_true() -> Any:
            nonlocal due_s
            if value := condition():
                return value
            if time.monotonic() > due_s:
                send()
                due_s = time.monotonic() + period_s
            return None
        return self.wait(sent_and_true, what, timeout_s)

    def publish_until_received(self, publisher: Publisher, message: Any, *, nodes: int = 1
                               ) -> None:
        """
        Publish a message until that many nodes have counted another one of its topic.

        The counts are those of the diagnostics: collect_diagnostics() comes first. As the
        camera_info of a camera it is repeated every second, so that what it starts does not
        depend on when a node has matched.
        """
        before = self._received_counts(publisher)

        def received() -> bool:
            counts = self._received_counts(publisher)
            return nodes <= sum(count > before.get(name, 0) for name, count in counts.items())
        self.send_until(lambda: publisher.publish(message), received,
                        f'{publisher.topic_name} received by {nodes} nodes')

    def _received_counts(self, publisher: Publisher) -> dict[tuple[str, str], int]:
        """Return how many messages of a topic each node has counted."""
        key = f"{publisher.topic_name.lstrip('/')} received"
        return {(status.name, status.hardware_id): int(value.value)
                for status in self.statuses()
                for value in status.values if value.key.lstrip('/') == key}

    def call(self, service_type: type, name: str, request: Any, timeout_s: float | None = None
             ) -> Any:
        """
        Return the response of a service to an idempotent request.

        A service that has not discovered the reader of its client yet drops the response, so
        the request is repeated every few seconds.
        """
        if name not in self._service_clients:
            self._service_clients[name] = self.create_client(service_type, name)
        client = self._service_clients[name]
        self.wait(client.service_is_ready, f'service {name}', timeout_s)
        futures: list[Any] = []

        def send() -> None:
            futures.append(client.call_async(request))
            self.requests[name] += 1
        return self.send_until(
            send, lambda: next((future for future in futures if future.done()), None),
            f'response of {name}', period_s=_REPEAT_REQUEST_S, timeout_s=timeout_s).result()

    # --- time ---

    def spin_once(self, timeout_s: float) -> None:
        """Process one message, if one comes in time; KeyboardInterrupt after SIGTERM as well."""
        if self.context.ok():
            with suppress(ExternalShutdownException):
                self._spinner.spin_once(timeout_sec=timeout_s)
                return
        raise KeyboardInterrupt

    def spin_for(self, seconds: float) -> None:
        """Process messages for a time."""
        self.spin_until(lambda: False, seconds)

    def spin_until(self, condition: Callable[[], Any], timeout_s: float) -> Any:
        """Process messages until a condition is true or the time is up; return its value."""
        deadline_s = time.monotonic() + timeout_s
        while not (value := condition()) and time.monotonic() < deadline_s:
            self.spin_once(_SPIN_S)
        return value

    def wait(self, condition: Callable[[], Any], what: str, timeout_s: float | None = None
             ) -> Any:
        """Return the value of a condition once it is true; HarnessError after the time limit."""
        timeout_s = self._timeout_s if timeout_s is None else timeout_s
        value = self.spin_until(condition, timeout_s)
        if not value:
            counts = {topic: len(messages) for topic, messages in self.received.items()}
            raise HarnessError(f'{what}: not within {timeout_s:g} s; received {counts}, '
                               f'diagnostics {self.conditions()}: see {self._log_folder}')
        return value

    # --- diagnostics ---

    def statuses(self) -> list[DiagnosticStatus]:
        """Return all statuses received, oldest first."""
        return [diagnostic.status for diagnostic in self.diagnostics]

    def conditions(self) -> list[str]:
        """Return the distinct texts of the statuses received."""
        return list(dict.fromkeys(f'{s.name}: {s.message}' for s in self.statuses()))

    def find_diagnostic(self, text: str, *, node: str = '', since_s: float = 0.0
                        ) -> Diagnostic | None:
        """Return the first diagnostic that contains a text, of one node or of any."""
        return next((diagnostic for diagnostic in self.diagnostics
                     if diagnostic.received_s >= since_s and node in ('', diagnostic.node)
                     and text in diagnostic.status.message), None)

    def wait_diagnostic(self, text: str, timeout_s: float | None = None) -> DiagnosticStatus:
        """Return the first status that contains a text; HarnessError after the time limit."""
        return self.wait(lambda: self.find_diagnostic(text), f'diagnostic {text!r}',
                         timeout_s).status

    def diagnostic_value(self, name: str, key: str, hardware_id: str = '') -> str | None:
        """Return the newest value of a key in the statuses of a name, None without one."""
        status = next((status for status in reversed(self.statuses()) if status.name == name
                       and hardware_id in ('', status.hardware_id)), None)
        return status and {value.key: value.value for value in status.values}.get(key)

    def longest_silence_s(self, node: str, since_s: float) -> float:
        """Return the longest time without a diagnostic of a node, until now."""
        times_s = [since_s, *(diagnostic.received_s for diagnostic in self.diagnostics
                              if diagnostic.received_s >= since_s and diagnostic.node == node)]
        return float(np.diff([*times_s, time.monotonic()]).max())
