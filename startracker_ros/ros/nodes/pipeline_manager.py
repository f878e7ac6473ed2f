# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""pipeline_manager: brings managed nodes up in order, and again after a restart."""

from dataclasses import dataclass
from functools import partial
import time
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from rclpy.task import Future
from startracker_ros.core.options import option, Options
from startracker_ros.ros.bringup import ACTIVATE, ACTIVE, Bringup, CONFIGURE, CONFIGURING, INACTIVE
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.node import main_of, PipelineNode

_TICK_S = 0.1
# The number of each transition, and the state that it leads to.
_TRANSITIONS = {CONFIGURE: (Transition.TRANSITION_CONFIGURE, INACTIVE),
                ACTIVATE: (Transition.TRANSITION_ACTIVATE, ACTIVE)}


@dataclass(frozen=True)
class ManagerOptions(Options):
    """Which nodes are managed, and how they are watched."""

    node_names: tuple[str, ...] = option(
        STAGES[::-1], 'managed nodes in the order of their activation, each after those that '
        'use what it publishes; relative names are in the namespace of the manager',
        read_only=True)
    heartbeat_period_s: float = option(
        1.0, 'period of the requests of ~/get_state to each node', unit='s', low=0.1, high=60.0,
        read_only=True)
    response_timeout_s: float = option(
        5.0, 'time after which a node without a response does not count as there, and a rejected '
        'transition is requested again', unit='s', low=1.0, high=600.0, read_only=True)


class PipelineManagerNode(PipelineNode):
    """
    Configures and activates nodes over the services of the lifecycle.

    The heartbeat of a node is its response to ~/get_state: it comes from the thread that
    processes the messages.
    """

    option_classes = (ManagerOptions,)
    task = 'nodes'

    def __init__(self) -> None:
        super().__init__('pipeline_manager')
        names = self.options(ManagerOptions).node_names
        self._states = {name: self.create_client(GetState, f'{name}/get_state') for name in names}
        self._changes = {name: self.create_client(ChangeState, f'{name}/change_state')
                         for name in names}
        self._pending: dict[Client, Future] = {}
        self._due_s = dict.fromkeys(names, 0.0)
        self._all_were_active = False
        self._alone_s = time.monotonic()
        self.create_steady_timer(_TICK_S, self._tick)

    def rebuild(self) -> None:
        options = self.options(ManagerOptions)
        self._bringup = Bringup(options.node_names, options.response_timeout_s)

    def _tick(self) -> None:
        if not self.active:
            return
        now_s = time.monotonic()
        for name, client in self._states.items():
            if now_s >= self._due_s[name]:
                # A response that is late or lost does not hold up the next request.
                self._request(name, client, GetState.Request())
        self._proceed()
        self._check_alone(now_s)
        serious, problems = self._bringup.problems(now_s)
        level = ERROR if serious else WARN if problems else OK
        self._all_were_active |= level == OK
        self.diagnostics.report(level, problems or f'all {len(self._states)} nodes are active',
                                expected=not self._all_were_active)

    def _check_alone(self, now_s: float) -> None:
        """Report another manager, which has a client of its own for as long as it runs."""
        others = [name for name in self._changes if self.count_clients(f'{name}/change_state') > 1]
        if not others:
            self._alone_s = now_s
        elif now_s - self._alone_s > self.options(ManagerOptions).response_timeout_s:
            self.diagnostics.report_event(
                f'another lifecycle manager has {", ".join(others)}, too: end one of the two, or '
                'launch with manager:=false')

    def _proceed(self) -> None:
        """Request the next transition of each node that has one."""
        for name, client in self._changes.items():
            if not {client, self._states[name]} & self._pending.keys() and (
                    wanted := self._bringup.transition(name, time.monotonic())):
                self.get_logger().info(f'{wanted} {name}')
                self._request(name, client, ChangeState.Request(
                    transition=Transition(id=_TRANSITIONS[wanted][0], label=wanted)))

    def _request(self, name: str, client: Client, request: Any) -> None:
        """Send a request instead of the one that is pending."""
        if client in self._pending:
            client.remove_pending_request(self._pending.pop(client))
        if client.service_is_ready():
            self._due_s[name] = time.monotonic() + self.options(ManagerOptions).heartbeat_period_s
            self._pending[client] = future = client.call_async(request)
            future.add_done_callback(partial(self._on_response, name, client, request))

    def _on_response(self, name: str, client: Client, request: Any, future: Future) -> None:
        if not self.active or self._pending.get(client) is not future:
            return
        del self._pending[client]
        response, now_s = future.result(), time.monotonic()
        if isinstance(response, GetState.Response):
            state = response.current_state.label
            if state != CONFIGURING:  # the response that is still pending was lost
                self._pending.pop(self._changes[name], None)
        else:
            wanted = request.transition.label
            if not response.success:
                self._bringup.on_failure(name, wanted, now_s)
                return
            state = _TRANSITIONS[wanted][1]
        if self._bringup.on_state(name, state, now_s):
            self.diagnostics.counts[f'restarts of {name}'] += 1
            self.diagnostics.report_event(f'{name} was restarted and is brought up again')
        self._proceed()


main = main_of(PipelineManagerNode)

if __name__ == '__main__':
    main()
