# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What rclpy keeps private and the nodes need: tried with rclpy 7.1, each with a way around.

Where a later rclpy has renamed an attribute, images are copied once more, misspelt parameters
are ignored and messages taken by the executor alone. Without its state machine a node cannot be
configured.
"""

from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any

from rclpy.lifecycle import LifecycleNode
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


def answer_change_state(node: LifecycleNode, answer: Callable) -> None:
    """Let answer(change_state, request, response) answer the requests of ~/change_state."""
    service: Any = node._service_change_state
    service.callback = partial(answer, service.callback)


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
