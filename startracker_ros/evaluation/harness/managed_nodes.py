# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Transitions of managed nodes, requested over their services as a lifecycle manager does."""

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from startracker_ros.ros.probe import Probe

UNCONFIGURED, INACTIVE, ACTIVE = (
    State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE)
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE)
NEXT_STATE = {
    (UNCONFIGURED, CONFIGURE): INACTIVE, (INACTIVE, ACTIVATE): ACTIVE,
    (ACTIVE, DEACTIVATE): INACTIVE, (INACTIVE, CLEANUP): UNCONFIGURED}
"""The primary states and transitions of the ROS 2 lifecycle, without shutdown."""

_CONNECT_ATTEMPTS = 40
_CONNECT_RESPONSE_S = 3.0


class NodeManager:
    """Changes the states of managed nodes; HarnessError where one does not respond."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._clients: dict[str, Client] = {}

    def change(self, node: str, transition: int) -> bool:
        """Return whether a transition succeeded; it is requested once only."""
        if node not in self._clients:
            self._clients[node] = self._connected(node)
        request = ChangeState.Request()
        request.transition.id = transition
        future = self._clients[node].call_async(request)
        self._probe.wait(future.done, f'the response of {node}')
        return future.result().success

    def state(self, node: str) -> int:
        """Return the primary state of a node."""
        return self._probe.call(
            GetState, f'/{node}/get_state', GetState.Request()).current_state.id

    def _connected(self, node: str) -> Client:
        """
        Return a client that the service has discovered.

        Until then responses are lost, so a transition that no state has is requested repeatedly.
        """
        client = self._probe.create_client(ChangeState, f'/{node}/change_state')
        self._probe.wait(client.service_is_ready, f'the services of {node}')
        futures = []
        for _ in range(_CONNECT_ATTEMPTS):
            futures.append(client.call_async(ChangeState.Request()))
            if self._probe.spin_until(
                    lambda: any(one.done() for one in futures), _CONNECT_RESPONSE_S):
                break
        self._probe.wait(lambda: any(one.done() for one in futures), f'a response of {node}')
        return client
