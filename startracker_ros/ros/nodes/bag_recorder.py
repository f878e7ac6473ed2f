"""bag_recorder: any topics, serialized -> an MCAP bag as rosbag2 writes it."""

from dataclasses import dataclass
from pathlib import Path
import shutil
import sys
import time
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from startracker_ros.bag.background import BackgroundWriter
from startracker_ros.bag.errors import BagError
from startracker_ros.bag.patterns import matches
from startracker_ros.bag.qos import QosProfile
from startracker_ros.bag.writer import BagOptions, BagWriter
from startracker_ros.options import option, Options
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.node import main_of, PipelineNode, StartError

_RETRY_S = 5.0
"""Time between two tries to go on after the disk has failed."""


@dataclass(frozen=True)
class RecordOptions(Options):
    """What is recorded, and where."""

    folder: str = option('', 'folder of the bag, made anew; empty for startracker_<date>_<time>',
                         read_only=True)
    topics: tuple[str, ...] = option(('*',), 'patterns of full topic names, * for any characters',
                                     read_only=True)
    exclude: tuple[str, ...] = option(
        ('*/image_annotated',), 'patterns of topics left out; image_annotated is drawn only for '
        'those who listen and can be drawn again', read_only=True)
    queue_depth: int = option(100, 'messages of a topic that wait for the recorder', low=1,
                              high=10000, read_only=True)
    queue_size_mb: float = option(
        256.0, 'messages of all topics that wait for compression and disk; what does not fit is '
        'dropped and counted', unit='MB', low=1.0, high=65536.0, read_only=True)
    discovery_period_s: float = option(0.1, 'how often new topics are looked for', unit='s',
                                       low=0.01, high=60.0, read_only=True)


class BagRecorderNode(PipelineNode):
    """
    Takes each message as the bytes it came in and writes them with both its times.

    After a failure of the disk the recording goes on in a new bag, <folder>_2 and so on, once
    the disk has room for the queue again.
    """

    option_classes = (RecordOptions, BagOptions)
    takes_message_info = True
    task = 'recording'

    def __init__(self) -> None:
        super().__init__('bag_recorder')
        options = self.options(RecordOptions)
        self._first_folder = self._folder = Path(
            options.folder or time.strftime('startracker_%Y_%m_%d-%H_%M_%S'))
        try:
            self._writer = self._open(self._folder)
        except BagError as error:
            raise StartError(str(error)) from error
        self._dropped_before = 0
        self._failed_s: float | None = None
        self._topics: dict[str, tuple[str, list[QosProfile]]] = {}
        self._unknown_types: set[str] = set()
        self._recorded: dict[str, Subscription] = {}
        self._outdated: set[str] = set()
        self.get_logger().info(f'recording to {self._folder}')
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(options.discovery_period_s, self._discover, clock=steady)
        self.create_timer(0.5, self._report, clock=steady)

    def close(self) -> None:
        """Close the bag."""
        try:
            self._writer.close()
        except BagError as error:
            print(f'[bag_recorder] {error}', file=sys.stderr)
        # The logger is gone with its context by now.
        print(f'[bag_recorder] {self._folder}: {self.diagnostics.counts["messages"]} messages of '
              f'{len(self._recorded)} topics, {self._lost()} lost', file=sys.stderr, flush=True)

    def _open(self, folder: Path) -> BackgroundWriter:
        return BackgroundWriter(
            BagWriter(folder, options=self.options(BagOptions)),
            queue_bytes=round(self.options(RecordOptions).queue_size_mb * 1e6))

    def _go_on(self) -> None:
        """Begin another bag where the disk takes one."""
        number = 2
        while (folder := self._first_folder.with_name(
                f'{self._first_folder.name}_{number}')).exists():
            number += 1
        needed = self.options(RecordOptions).queue_size_mb * 1e6
        try:
            if shutil.disk_usage(folder.absolute().parent).free < needed:
                return
            writer = self._open(folder)
            for topic, (type_name, profiles) in self._topics.items():
                writer.add_topic(topic, type_name, profiles)
        except (BagError, OSError):
            # Made just now, and nothing is in it.
            shutil.rmtree(folder, ignore_errors=True)
            return
        self._dropped_before += self._writer.dropped
        self._writer, self._folder = writer, folder
        self.diagnostics.note(f'the recording goes on in {folder}')

    def _discover(self) -> None:
        options = self.options(RecordOptions)
        for topic, types in self.get_topic_names_and_types():
            wanted = matches(topic, options.topics) and not matches(topic, options.exclude)
            if wanted and (topic not in self._recorded or topic in self._outdated):
                offers = self.get_publishers_info_by_topic(topic)
                if offers:
                    self._record(topic, types[0], offers)

    def _record(self, topic: str, type_name: str, offers: list[TopicEndpointInfo]) -> None:
        try:
            message_type = message_class(type_name)
        except ImportError:
            if type_name not in self._unknown_types:
                self._unknown_types.add(type_name)
                self.get_logger().warning(f'{topic} is not recorded: {type_name} is not installed')
            return
        if topic in self._recorded:
            self.destroy_subscription(self._recorded[topic])
            self._outdated.discard(topic)
        else:
            profiles = [_bag_qos(offer.qos_profile) for offer in offers]
            try:
                if self._writer.error is None:
                    self._writer.add_topic(topic, type_name, profiles)
            except BagError as error:
                self.diagnostics.report(ERROR, str(error))
                return
            self._topics[topic] = type_name, profiles
        self._recorded[topic] = self._subscribe(topic, message_type, offers)
        self.diagnostics.values['topics'] = len(self._recorded)

    def _subscribe(self, topic: str, message_type: type,
                   offers: list[TopicEndpointInfo]) -> Subscription:
        def write(message: bytes, info: dict) -> None:
            if self._writer.write(topic, message, info['received_timestamp'],
                                  info['source_timestamp']):
                self.diagnostics.counts['messages'] += 1

        def lose(event: Any) -> None:
            self.diagnostics.counts['messages lost before the recorder'] += (
                event.total_count_change)

        # A publisher that offers less came later: the next look adapts to all there are.
        events = SubscriptionEventCallbacks(
            message_lost=lose, incompatible_qos=lambda event: self._outdated.add(topic))
        # rclpy hands the info to whoever takes two arguments, its hint knows of one.
        return self.create_subscription(
            message_type, topic, write,  # type: ignore[arg-type]
            self._matching_qos(offers), raw=True, event_callbacks=events)

    def _matching_qos(self, offers: list[TopicEndpointInfo]) -> QoSProfile:
        """Return the strictest profile that hears every publisher there is."""
        reliable = all(offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                       for offer in offers)
        local = all(offer.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                    for offer in offers)
        return QoSProfile(
            depth=self.options(RecordOptions).queue_depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if local else DurabilityPolicy.VOLATILE)

    def _lost(self) -> int:
        return (self.diagnostics.counts['messages lost before the recorder']
                + self._dropped_before + self._writer.dropped)

    def _report(self) -> None:
        """Say how the recording goes; writing fails in another thread."""
        dropped = self._dropped_before + self._writer.dropped
        if dropped:
            self.diagnostics.counts['messages dropped'] = dropped
        if self._writer.error is not None:
            self.diagnostics.report(ERROR, str(self._writer.error))
            if self._failed_s is None:
                self._failed_s = time.monotonic()
            elif time.monotonic() > self._failed_s + _RETRY_S:
                self._failed_s = None
                self._go_on()
        elif self._lost():
            self.diagnostics.report(WARN, f'recording; {self._lost()} messages are lost')
        elif self.diagnostics.counts['messages']:
            self.diagnostics.report(OK, 'recording')


def _bag_qos(profile: QoSProfile) -> QosProfile:
    return QosProfile(
        history=profile.history.name.lower(), depth=profile.depth,
        reliability=profile.reliability.name.lower(), durability=profile.durability.name.lower(),
        deadline_ns=profile.deadline.nanoseconds, lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration_ns=profile.liveliness_lease_duration.nanoseconds)


main = main_of(BagRecorderNode)

if __name__ == '__main__':
    main()
