# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which nodes can process their next message: active, set up for the camera, and connected."""

from collections.abc import Mapping, Sequence
import time

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.task import Future
from startracker_ros.ros.camera_node import CAMERA
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.probe import Probe

_REPEAT_REQUEST_S = 0.5
Needs = Mapping[str, Sequence[str]]
"""Values that the diagnostics of each node must have before the first frame, by full name."""


def needs_of(nodes: Sequence[str], namespace: str = '') -> dict[str, Sequence[str]]:
    """Return the needs of nodes in a namespace."""
    prefix = f'/{namespace}' if namespace else ''
    return {f'{prefix}/{node}': (CAMERA,) if node in STAGES else () for node in nodes}


class _Node:
    """What is known of one node."""

    def __init__(self, name: str, probe: Probe, needs: Sequence[str]) -> None:
        namespace, _, self.name = name[1:].rpartition('/')
        self.hardware_id = namespace or 'star_tracker'
        self.needs = set(needs)
        self.condition = 'starting'
        self.task = ''
        self.received_s = 0.0
        self.active_s = 0.0
        """When the newest request was sent that was answered by a node that is active."""
        self._client: Client = probe.create_client(GetState, f'{name}/get_state')
        self._requests: list[tuple[float, Future]] = []

    def ask(self, since_s: float) -> None:
        """Ask for the state until it is active and asked since then; requests may be lost."""
        self.active_s = max([self.active_s, *(
            sent_s for sent_s, future in self._requests
            if future.done() and future.result().current_state.id == State.PRIMARY_STATE_ACTIVE)])
        now_s, sent_s = time.monotonic(), self._requests[-1][0] if self._requests else 0.0
        wanted_s = since_s if since_s <= now_s else 0.0
        is_due = sent_s <= wanted_s or now_s > sent_s + _REPEAT_REQUEST_S
        if self.active_s <= wanted_s and is_due and self._client.service_is_ready():
            self._requests = [*self._requests[-5:], (
                now_s, self._client.call_async(GetState.Request()))]

    def text(self, since_s: float) -> str:
        """Return why the node is not ready, empty if it is; it was asked since then."""
        if self.active_s > since_s and not self.needs:
            return ''
        if self.active_s and self.task and not self.needs:
            return 'waiting for connections'
        return self.condition


class Readiness:
    """
    Follows nodes until they are ready; the probe collects their diagnostics.

    A node is ready when its diagnostics have what it needs, and it has answered that it is active
    to a request sent after connected() was called: by then it has discovered what the probe
    had.
    """

    def __init__(self, probe: Probe, needs: Needs) -> None:
        self._probe = probe
        self._nodes = {name: _Node(name, probe, counts) for name, counts in needs.items()}
        self._seen = 0
        self._connected_s = float('inf')

    def connected(self) -> None:
        """Note that all endpoints are discovered, at the first call."""
        self._connected_s = min(self._connected_s, time.monotonic())

    def update(self) -> None:
        """Use what has been received, and ask for the states."""
        for diagnostic in self._probe.diagnostics[self._seen:]:
            status = diagnostic.status
            for node in self._nodes.values():
                if node.name == diagnostic.node.rpartition('/')[2] and (
                        node.hardware_id == status.hardware_id):
                    node.task = node.task or status.name
                    node.received_s = diagnostic.received_s
                    node.needs -= {value.key for value in status.values}
                    if status.name == node.task:
                        node.condition = status.message
        self._seen = len(self._probe.diagnostics)
        for node in self._nodes.values():
            node.ask(self._connected_s)

    def conditions(self) -> dict[str, str]:
        """Return why each node is not ready, empty for those that are."""
        return {name: node.text(self._connected_s) for name, node in self._nodes.items()}

    def activity(self) -> object:
        """Return what changes while a node starts: conditions, diagnostics while it loads."""
        return self.conditions(), [
            node.received_s for node in self._nodes.values() if not node.active_s or node.needs]
