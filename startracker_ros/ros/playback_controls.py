# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Services of the bag player, and its end."""

from collections.abc import Callable, Iterable
import time

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from startracker_ros.io.bags.playback import Playback
from startracker_ros.ros.node import PipelineNode

_LAST_MESSAGES_S = 10.0


def advertise_controls(node: PipelineNode, playback: Callable[[], Playback | None]) -> None:
    """Advertise ~/pause, ~/resume and ~/step of the current playback."""
    def advertise(name: str, act: Callable[[Playback], tuple[bool, str]]) -> None:
        def on_request() -> tuple[bool, str]:
            current = playback()
            return (False, 'not configured') if current is None else act(current)
        node.advertise_trigger(name, on_request)
    advertise('pause', lambda current: (current.pause(), 'paused'))
    advertise('resume', lambda current: (current.resume(), 'playing'))
    advertise('step', lambda current: (
        (True, 'one message more') if current.step() else (False, 'not paused: pause first')))


def wait_for_subscribers(publishers: Iterable[Publisher]) -> None:
    """Wait until the last messages are acknowledged, for a short time."""
    end_s = time.monotonic() + _LAST_MESSAGES_S
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, end_s - time.monotonic())))


def summary(playback: Playback, topics: int) -> str:
    """Return what was played, and how late."""
    median, p95, worst = playback.pacing_ms()
    return (f'{playback.published} messages of {topics} topics; late by {median:.2f} ms median, '
            f'{p95:.2f} ms p95, {worst:.2f} ms at most')
