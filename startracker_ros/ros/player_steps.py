# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of the bag player: chosen topics, wait for subscribers, services, its end."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo
from startracker_ros.core.camera.model import CameraError
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.layouts import camera_from_message
from startracker_ros.io.bags.playback import held_before, held_messages, Playback, PlayOptions
from startracker_ros.io.bags.reader import BagMessage, BagTopic, selected, TolerantBag
from startracker_ros.io.bags.schemas import message_schema
from startracker_ros.ros.camera_node import CAMERA, camera_text
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.managed import StartError
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.node import hardware_id_of, PipelineNode

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'

_LAST_MESSAGES_S = 10.0
_UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'
_CAMERA_PERIOD_S = 1.0
_DIAGNOSTICS_DEPTH = 100


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


class AwaitedSubscribers:
    """
    The subscribers that a player waits for, from now until the limit of its options.

    cameras are those of first_cameras(): users of camera_info that are awaited receive it while
    the player waits, as those of sources do, and are there once their diagnostics name this
    camera.
    """

    def __init__(self, publishers: Mapping[str, Publisher],
                 cameras: Mapping[str, tuple[bytes, str]], options: PlayOptions,
                 node: PipelineNode) -> None:
        self._publishers = publishers
        self._cameras = {publishers[topic]: camera for topic, camera in cameras.items()}
        self._options = options
        self._node = node
        self._limit_s = time.monotonic() + options.wait_limit_s
        self._begin_s: float | None = None
        self._camera_sent_s: float | None = None
        self._set_up: dict[tuple[str, str], str] = {}
        self._subscription = node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, _DIAGNOSTICS_DEPTH)

    def close(self) -> None:
        """Wait no more."""
        self._node.destroy_subscription(self._subscription)

    def are_there(self) -> bool:
        """Return whether to begin: all are there or the limit is over, and the delay as well."""
        now_s = time.monotonic()
        if self._begin_s is None:
            missing = self._missing(now_s)
            if missing and now_s < self._limit_s:
                self._node.diagnostics.report_event(f'waiting for {missing}', expected=True)
                return False
            self._begin_s = now_s + self._options.start_delay_s
            if missing:
                self._node.get_logger().warning(f'played without all {missing}')
        return now_s >= self._begin_s

    def _missing(self, now_s: float) -> str:
        """Return the topics with fewer subscribers that are there than the options name, or ''."""
        if missing := [publisher.topic_name for publisher in self._publishers.values()
                       if publisher.get_subscription_count() < self._needed(publisher)]:
            return f'subscribers of {", ".join(missing)}'
        missing = [publisher.topic_name for publisher, (_, camera) in self._cameras.items()
                   if self._users_of(publisher, camera) < self._needed_users(publisher)]
        if not missing:
            return ''
        if self._camera_sent_s is None or now_s - self._camera_sent_s >= _CAMERA_PERIOD_S:
            self._camera_sent_s = now_s
            for publisher, (data, _) in self._cameras.items():
                publisher.publish(data)
        return f'users of {", ".join(missing)} that are set up for this camera'

    def _needed(self, publisher: Publisher) -> int:
        options = self._options
        return max(options.wait_for_subscribers,
                   options.wait_for_camera_users if publisher.msg_type is CameraInfo else 0)

    def _needed_users(self, publisher: Publisher) -> int:
        """Return how many users of a camera_info are awaited, at least the stages there."""
        stages = 0
        if self._options.wait_for_subscribers:
            # A subscriber is matched before the name of its node is known.
            names = [one.node_name for one in self._node.get_subscriptions_info_by_topic(
                publisher.topic_name)]
            stages = sum(name in (*STAGES, _UNKNOWN_NODE) for name in names) + max(
                0, publisher.get_subscription_count() - len(names))
        return max(self._options.wait_for_camera_users, stages)

    def _users_of(self, publisher: Publisher, camera: str) -> int:
        """Return how many nodes in the namespace of a camera_info are set up for its camera."""
        hardware_id = hardware_id_of(publisher.topic_name.rpartition('/')[0])
        return sum(text == camera for (node_id, _), text in self._set_up.items()
                   if node_id == hardware_id)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if self._camera_sent_s is None:
            # What they say before may be of the same camera at another epoch.
            return
        for status in message.status:
            self._set_up[status.hardware_id, status.name] = next(
                (value.value for value in status.values if value.key == CAMERA), '')


def first_cameras(bag: TolerantBag, topics: Iterable[BagTopic], start_ns: int
                  ) -> dict[str, tuple[bytes, str]]:
    """
    Return the first message of each topic of camera_info from a log time on, and its camera.

    The camera is that of camera_text(). Topics without a valid camera are left out.
    """
    first = {}
    for topic in topics:
        message = next(bag.messages((topic.name,), start_ns), None) if (
            topic.type_name == CAMERA_INFO) else None
        if message is not None:
            with suppress(BagError, CameraError):
                first[topic.name] = message.data, camera_text(
                    camera_from_message(message.decoded()))
    return first


def open_playable(options: PlayOptions, *, own_clock: bool, warn: Callable[[str], object],
                  on_damage: Callable[[str], None]
                  ) -> tuple[TolerantBag, tuple[int, int], list[BagTopic]]:
    """Return a bag, its span in ns and what is played of it; StartError without anything."""
    if not options.path:
        raise StartError('path is empty: name a bag folder or an .mcap file')
    try:
        bag = TolerantBag(Path(options.path), on_damage)
    except BagError as error:
        raise StartError(str(error)) from error
    chosen, reasons = playable_topics(bag.topics.values(), options, own_clock=own_clock)
    for reason in reasons:
        warn(reason)
    if _images_without_camera(chosen):
        warn(f'{options.path}: images without camera_info: the stages wait for one; publish the '
             'calibration of the camera on camera_info (startracker calibrate finds it)')
    if bag.span_ns is None or not chosen:
        why = '; '.join(reasons) or (
            'they have no messages' if chosen else
            f'topics = {list(options.topics)} without exclude = {list(options.exclude)} fits none')
        raise StartError(f'{options.path}: nothing to play among '
                         + (f'{", ".join(sorted(bag.topics))}: {why}' if bag.topics
                            else 'no topics'))
    return bag, bag.span_ns, chosen


def _images_without_camera(topics: Iterable[BagTopic]) -> bool:
    """Return whether images are played, and nothing says which camera took them."""
    types = {topic.type_name for topic in topics}
    return (CAMERA_INFO not in types
            and bool(types & {'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'}))


def held_by_latched(bag: TolerantBag, topics: Iterable[BagTopic], wanted: bool, start_ns: int
                    ) -> list[BagMessage]:
    """Return what the latched ones of topics held at a log time, nothing where not wanted."""
    held = {topic.name: count for topic in topics if (count := held_messages(topic.qos))}
    if not wanted or not held:
        return []
    return held_before(bag.messages(tuple(held), 0), held, start_ns)


def playable_topics(topics: Iterable[BagTopic], options: PlayOptions, *, own_clock: bool
                    ) -> tuple[list[BagTopic], list[str]]:
    """Return the selected topics that can be published, and of each that cannot why."""
    playable, reasons = [], []
    for topic in topics:
        if selected(topic.name, options.topics, options.exclude):
            reason = _why_not_playable(topic, own_clock)
            if reason:
                reasons.append(f'{topic.name} is not played: {reason}')
            else:
                playable.append(topic)
    return playable, reasons


def _why_not_playable(topic: BagTopic, own_clock: bool) -> str:
    """Return why a topic cannot be published, empty if it can; own_clock: the player makes it."""
    if topic.encoding != 'cdr':
        return f'its messages are {topic.encoding!r}, not cdr'
    if topic.name == '/clock' and own_clock:
        return 'clock_rate_hz makes a new one'
    try:
        message_class(topic.type_name)
    except (ImportError, ValueError):
        return f'{topic.type_name or "a topic without a type"} is not installed'
    installed = message_schema(topic.type_name).type_hash
    if topic.schema.type_hash and installed not in ('', topic.schema.type_hash):
        return f'{topic.type_name} was recorded with another definition'
    return ''
