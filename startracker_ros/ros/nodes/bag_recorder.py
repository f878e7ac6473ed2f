# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""bag_recorder: any topics, serialized -> an MCAP bag as rosbag2 writes it."""

import sys

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import Imu
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.reader import selected
from startracker_ros.io.bags.recording import Recording, RecordOptions
from startracker_ros.io.bags.writer import BagOptions
from startracker_ros.ros import qos
from startracker_ros.ros.bag_qos import bag_qos, recording_qos
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.messages.rclpy_internals import with_message_info
from startracker_ros.ros.node import main_of, PipelineNode, StartError

_LOST_BEFORE = 'messages lost before the recorder'


class BagRecorderNode(PipelineNode):
    """Records serialized messages with the times of publication and reception."""

    option_classes = (RecordOptions, BagOptions)
    task = 'recording'

    def __init__(self) -> None:
        super().__init__('bag_recorder')
        options = self.options(RecordOptions)
        try:
            self._recording = Recording(options, self.options(BagOptions))
        except BagError as error:
            raise StartError(str(error)) from error
        self._unknown_types: set[str] = set()
        self._recorded: dict[str, Subscription] = {}
        self._incompatible: set[str] = set()
        self.get_logger().info(f'recording to {self._recording.folder}')
        self.create_steady_timer(options.discovery_period_s, self._discover)
        self.create_steady_timer(0.5, self._report)

    def close(self) -> None:
        try:
            self._recording.close()
        except BagError as error:
            print(f'[bag_recorder] {error}', file=sys.stderr)
        count = self.diagnostics.counts['messages']
        # The logger is not available any more.
        print(f'[bag_recorder] {self._recording.folder}: {count} messages of '
              f'{len(self._recorded)} topics, {self._lost()} lost', file=sys.stderr, flush=True)

    def _discover(self) -> None:
        options = self.options(RecordOptions)
        for topic, types in self.get_topic_names_and_types():
            new = topic not in self._recorded or topic in self._incompatible
            if new and selected(topic, options.topics, options.exclude) and (
                    publishers := self.get_publishers_info_by_topic(topic)):
                self._record(topic, types[0], publishers)

    def _record(self, topic: str, type_name: str, publishers: list[TopicEndpointInfo]) -> None:
        try:
            message_type = message_class(type_name)
        except ImportError:
            if type_name not in self._unknown_types:
                self._unknown_types.add(type_name)
                self.get_logger().warning(f'{topic} is not recorded: {type_name} is not installed')
            return
        if topic in self._recorded:
            self.destroy_subscription(self._recorded[topic])
            self._incompatible.remove(topic)
        else:
            profiles = [bag_qos(publisher.qos_profile) for publisher in publishers]
            try:
                self._recording.add_topic(topic, type_name, profiles)
            except BagError as error:
                self.diagnostics.report(ERROR, str(error))
                return
        self._recorded[topic] = self._subscribe(topic, message_type, publishers)
        self.diagnostics.values['topics'] = len(self._recorded)

    def _subscribe(self, topic: str, message_type: type,
                   publishers: list[TopicEndpointInfo]) -> Subscription:
        def write(message: bytes, info: dict) -> None:
            if self.active and self._recording.write(
                    topic, message, info['received_timestamp'], info['source_timestamp']):
                self.diagnostics.counts['messages'] += 1

        depth = self.options(RecordOptions).queue_depth
        # What a gyro measures between two frames may come at once, while images are written.
        profile = recording_qos(
            publishers, max(depth, qos.IMU.depth) if message_type is Imu else depth)
        # After a publisher with a weaker profile the next discovery subscribes again.
        events = SubscriptionEventCallbacks(
            message_lost=lambda event: self.diagnostics.counts.update(
                {_LOST_BEFORE: event.total_count_change}),  # type: ignore[attr-defined]
            incompatible_qos=lambda _: self._incompatible.add(topic))
        return self.create_subscription(
            message_type, topic, with_message_info(write), profile, raw=True,
            event_callbacks=events)

    def _lost(self) -> int:
        return self._recording.dropped + self.diagnostics.counts[_LOST_BEFORE]

    def _report(self) -> None:
        """Report the state of the recording, which fails in another thread."""
        recording = self._recording
        if recording.dropped:
            self.diagnostics.counts['messages dropped'] = recording.dropped
        if recording.error is not None:
            self.diagnostics.report(ERROR, str(recording.error))
            if recording.retry():
                self.diagnostics.report_event(f'the recording goes on in {recording.folder}')
        elif self._lost():
            self.diagnostics.report(WARN, f'recording; {self._lost()} messages are lost')
        elif self.diagnostics.counts['messages']:
            self.diagnostics.report(OK, 'recording')


main = main_of(BagRecorderNode)

if __name__ == '__main__':
    main()
