# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What rclpy keeps private and the nodes need: tried with rclpy 7.1, each with a way around.

Where a later rclpy has renamed an attribute, images are copied once more, misspelt parameters
are ignored and messages taken by the executor alone. Without its state machine a node cannot be
configured.
"""

from collections.abc import Callable
from inspect import signature
from typing import Any

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image


def set_image_data(message: Image | CompressedImage, data: memoryview) -> None:
    """
    Let an image message show a buffer instead of a copy.

    The property would copy it into an array.array; the conversion to DDS takes any buffer.
    """
    if hasattr(message, '_data'):
        message._data = data
    else:
        message.data.frombytes(data)


def parameter_overrides(node: Node) -> dict[str, Any]:
    """Return the parameters given at the start by name, as rclpy.parameter.Parameter."""
    return getattr(node, '_parameter_overrides', {})


def declared_parameters(node: Node) -> list[str]:
    """Return the names of the parameters that a node declared."""
    return list(getattr(node, '_parameters', {}))


class _Answer:
    """A response and the header of its request, sent when both are known."""

    def __init__(self, send: Callable[[Any, Any], None]) -> None:
        self._send = send
        self._response: Any = None
        self._header: Any = None

    def respond(self, response: Any) -> None:
        self._response = response
        self._send_complete()

    def address(self, header: Any) -> None:
        self._header = header
        self._send_complete()

    def _send_complete(self) -> None:
        if self._response is not None and self._header is not None:
            self._send(self._response, self._header)


def intercept_change_state(node: LifecycleNode, intercept: Callable) -> None:
    """
    Let intercept(change_state, request, response, respond) answer the requests of ~/change_state.

    respond(response) may be called at once or later, in the thread of the executor.
    """
    service: Any = node._service_change_state
    change_state, send = service.callback, service.send_response

    def on_request(request: Any, response: Any) -> _Answer:
        answer = _Answer(send)
        intercept(change_state, request, response, answer.respond)
        return answer
    service.callback = on_request
    # Both executors call it with what the callback has returned.
    service.send_response = _Answer.address


def start_transition(node: LifecycleNode, transition_id: int) -> None:
    """Enter the state of a transition in progress; RCLError where there is no such transition."""
    node._state_machine.trigger_transition_by_id(transition_id, True)


def end_transition(node: LifecycleNode, result: TransitionCallbackReturn) -> None:
    """Enter the state that a transition in progress leads to with its result."""
    node._state_machine.trigger_transition_by_label(result.to_label(), True)


def lifecycle_state(node: LifecycleNode) -> str:
    """Return the label of the state that a managed node is in, empty where it is not known."""
    machine = getattr(node, '_state_machine', None)
    return '' if machine is None else machine.current_state[1]


def with_message_info(callback: Callable[[Any, dict], None]) -> Callable:
    """
    Return callback(message, info) for a subscription.

    The events executor of rclpy 7.1.6 passes both as one tuple, other executors as two arguments.
    """
    def received(*arguments: Any) -> None:
        callback(*(arguments[0] if len(arguments) == 1 else arguments))
    # rclpy counts the parameters.
    received.__signature__ = signature(callback)  # type: ignore[attr-defined]
    return received


def take_all(subscription: Subscription, callback: Callable[[Any], None]) -> None:
    """Call callback(message) for all messages that wait, before the executor comes to them."""
    take = getattr(subscription.handle, 'take_message', None)
    if take is not None:
        while (taken := take(subscription.msg_type, subscription.raw)) is not None:
            callback(taken[0])
