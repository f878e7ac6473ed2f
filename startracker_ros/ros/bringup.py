# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""In which order managed nodes are brought up, and again after a restart; without ROS."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = 'unconfigured', 'inactive', 'active', 'finalized'
CONFIGURING = 'configuring'
CONFIGURE, ACTIVATE = 'configure', 'activate'


@dataclass
class _Node:
    """
    What is known of a node: its state, when it responded, what it has rejected.

    was_active: since it was unconfigured. next_request_s: not before, after a rejection.
    """

    state: str = ''
    response_s: float = -math.inf
    next_request_s: float = -math.inf
    was_active: bool = False
    failed: str = ''


class Bringup:
    """
    The states of managed nodes by their responses, and the next transition of each.

    A node is configured after all before it, and activated when all are configured and those
    before it are active. One that is unconfigured after it was active has been restarted, or
    cleaned up, and is brought up again. One that is inactive after it was active was
    deactivated by somebody, and stays inactive.
    """

    def __init__(self, names: Sequence[str], timeout_s: float) -> None:
        if not all(names) or len(set(names)) != len(names):
            raise ValueError(f'node_names = {list(names)}: names must differ, none may be empty')
        self._nodes = {name: _Node() for name in names}
        self._timeout_s = timeout_s

    def on_state(self, name: str, state: str, now_s: float) -> bool:
        """Accept the state that a node has reported; return whether it was restarted."""
        node = self._nodes[name]
        restarted = state == UNCONFIGURED and node.was_active
        if restarted or state == ACTIVE:
            node.failed, node.next_request_s = '', -math.inf
        node.was_active = state == ACTIVE or node.was_active and not restarted
        node.state, node.response_s = state, now_s
        return restarted

    def on_failure(self, name: str, transition: str, now_s: float) -> None:
        """Remember that a node has rejected a transition; it is requested again later."""
        node = self._nodes[name]
        node.failed, node.next_request_s = transition, now_s + self._timeout_s

    def transition(self, name: str, now_s: float) -> str:
        """Return what to request of a node now, configure or activate; empty for nothing."""
        node = self._nodes[name]
        if now_s < node.next_request_s:
            return ''
        names = list(self._nodes)
        before = names[:names.index(name)]
        state = self._state(name, now_s)
        if state == UNCONFIGURED and all(self._is_configured(one, now_s) for one in before):
            return CONFIGURE
        if (state == INACTIVE and not node.was_active
                and all(self._is_configured(one, now_s) for one in names)
                and all(self._nodes[one].was_active for one in before)):
            return ACTIVATE
        return ''

    def problems(self, now_s: float) -> tuple[bool, str]:
        """Return whether somebody has to act, and what keeps nodes from being active, or ''."""
        found, serious = [], False
        for name, node in self._nodes.items():
            state = self._state(name, now_s)
            if state == ACTIVE:
                continue
            failed = node.failed if state in (UNCONFIGURED, INACTIVE) else ''
            serious |= bool(failed) or state == FINALIZED or not state and node.was_active
            found.append(f'{name} ' + (
                f'rejects {failed}, see its log' if failed
                else f'is {state}' if state else 'does not respond'))
        return serious, ', '.join(found)

    def _state(self, name: str, now_s: float) -> str:
        """Return the state of a node, empty where it does not respond."""
        node = self._nodes[name]
        return node.state if now_s - node.response_s <= self._timeout_s else ''

    def _is_configured(self, name: str, now_s: float) -> bool:
        return self._state(name, now_s) in (INACTIVE, ACTIVE)
