"""Real nodes in processes of their own, and a probe that talks with them over DDS."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
import os
from pathlib import Path
import time
from typing import Any

import pytest

# Before rclpy is imported: a domain of our own, this machine only, the shipped profile.
os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from startracker_ros.harness.processes import node_environment, NodeProcesses  # noqa: E402

os.environ.update(node_environment())

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
import rclpy  # noqa: E402
from rclpy.node import Node  # noqa: E402


HANGS_S = 120.0
"""A wait this long means that a node hangs: on a busy machine all takes ten times as long."""


class Probe(Node):
    """Publishes to nodes and keeps all that they say."""

    def __init__(self) -> None:
        super().__init__('probe')
        self.received: dict[str, list[Any]] = defaultdict(list)
        self.requests: Counter[str] = Counter()
        self.listen(DiagnosticArray, '/diagnostics')

    def listen(self, message_type: type, topic: str, profile: Any = 10) -> None:
        """Keep every message of a topic in received[topic]."""
        self.create_subscription(message_type, topic, self.received[topic].append, profile)

    def speak(self, message_type: type, topic: str, profile: Any = 10, *, to: int = 1) -> Any:
        """Return a publisher once it has found its subscribers."""
        publisher = self.create_publisher(message_type, topic, profile)
        self.wait(lambda: publisher.get_subscription_count() >= to,
                  f'{to} subscriber of {topic}')
        # The subscriber may hear of the publisher a little later than the other way round.
        self.spin_for(0.5)
        return publisher

    def ask(self, service_type: type, name: str, request: Any) -> Any:
        """
        Return the answer of a service to a request that may be repeated without harm.

        A service that has not yet discovered its client's reader drops the answer, so what
        is not answered is asked again, as any caller over DDS has to.
        """
        client = self.create_client(service_type, name)
        self.wait(client.service_is_ready, name)
        answers: list[Any] = []

        def answered() -> bool:
            if not answers or time.monotonic() > answers[-1][0] + 3:
                answers.append((time.monotonic(), client.call_async(request)))
                self.requests[name] += 1
            return any(future.done() for _, future in answers)
        self.wait(answered, f'an answer of {name}')
        return next(future for _, future in answers if future.done()).result()

    def wait(self, condition: Callable[[], Any], what: str, timeout_s: float = HANGS_S) -> Any:
        """Spin until the condition is true and return its value; fail by name if it never is."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            value = condition()
            if value:
                return value
            rclpy.spin_once(self, timeout_sec=0.05)
        pytest.fail(f'waited {timeout_s:.0f} s for {what}; heard '
                    f'{ {topic: len(got) for topic, got in self.received.items()} }, '
                    f'diagnostics {self.conditions()}')

    def spin_for(self, seconds: float) -> None:
        """Listen for a while."""
        deadline_s = time.monotonic() + seconds
        while time.monotonic() < deadline_s:
            rclpy.spin_once(self, timeout_sec=0.05)

    def statuses(self) -> list[Any]:
        """Return all diagnostics heard, oldest first."""
        return [status for array in self.received['/diagnostics'] for status in array.status]

    def conditions(self) -> list[str]:
        """Return the texts of the diagnostics heard, without repeats."""
        return list(dict.fromkeys(f'{s.name}: {s.message}' for s in self.statuses()))

    def wait_condition(self, words: str, timeout_s: float = HANGS_S) -> Any:
        """Wait for a diagnostic whose text holds the words."""
        return self.wait(
            lambda: next((s for s in self.statuses() if words in s.message), None),
            f'a diagnostic with {words!r}', timeout_s)


@pytest.fixture
def probe() -> Iterator[Probe]:
    """Return a probe in this test's own domain."""
    rclpy.init()
    node = Probe()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[NodeProcesses]:
    """Return a starter of nodes; every one must end cleanly after the test."""
    with NodeProcesses(tmp_path) as processes:
        yield processes
        codes = processes.stop(HANGS_S)
    logs = {path.name: path.read_text() for path in tmp_path.glob('*.log')}
    assert all(code == 0 for code in codes.values()), (codes, logs)
    assert not any('Traceback' in text for text in logs.values()), logs
