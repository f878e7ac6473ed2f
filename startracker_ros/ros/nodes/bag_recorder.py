"""bag_recorder: any topics, serialized -> an MCAP bag as rosbag2 writes it."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
import time

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from startracker_ros.bag.errors import BagError
from startracker_ros.bag.qos import QosProfile
from startracker_ros.bag.writer import BagOptions, BagWriter
from startracker_ros.options import option, Options
from startracker_ros.ros.diagnostics import ERROR, OK
from startracker_ros.ros.messages import message_class
from startracker_ros.ros.node import main_of, PipelineNode, StartError


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
    queue_depth: int = option(100, 'messages of a topic kept while the disk is busy', low=1,
                              high=10000, read_only=True)
    discovery_period_s: float = option(0.1, 'how often new topics are looked for', unit='s',
                                       low=0.01, high=60.0, read_only=True)


class BagRecorderNode(PipelineNode):
    """Takes each message as the bytes it came in and writes them with both its times."""

    option_classes = (RecordOptions, BagOptions)
    task = 'recording'

    def __init__(self) -> None:
        super().__init__('bag_recorder')
        options = self.options(RecordOptions)
        folder = options.folder or time.strftime('startracker_%Y_%m_%d-%H_%M_%S')
        try:
            self._writer = BagWriter(Path(folder), options=self.options(BagOptions))
        except BagError as error:
            raise StartError(str(error)) from error
        self._unknown_types: set[str] = set()
        self._recorded: set[str] = set()
        self._failed = False
        self.get_logger().info(f'recording to {folder}')
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(options.discovery_period_s, self._discover, clock=steady)
        self.create_timer(1.0, self._flush, clock=steady)

    def destroy_node(self) -> None:
        """Close the bag, then the node."""
        try:
            self._writer.close()
        except BagError as error:
            self.get_logger().error(str(error))
        super().destroy_node()

    def _discover(self) -> None:
        options = self.options(RecordOptions)
        for topic, types in self.get_topic_names_and_types():
            wanted = _matches(topic, options.topics) and not _matches(topic, options.exclude)
            if wanted and topic not in self._recorded:
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
        try:
            self._writer.add_topic(topic, type_name, [_bag_qos(o.qos_profile) for o in offers])
        except BagError as error:
            self._fail(error)
            return
        self._recorded.add(topic)
        self.diagnostics.values['topics'] = len(self._recorded)

        def write(message: bytes, info: dict) -> None:
            self._write(topic, message, info)
        self.create_subscription(message_type, topic, write, self._matching_qos(offers), raw=True)

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

    def _write(self, topic: str, message: bytes, info: dict) -> None:
        if self._failed:
            self.diagnostics.counts['messages lost'] += 1
            return
        try:
            self._writer.write(topic, message, info['received_timestamp'],
                               info['source_timestamp'])
        except BagError as error:
            self._fail(error)
            return
        self.diagnostics.counts['messages'] += 1
        self.diagnostics.report(OK, 'recording')

    def _flush(self) -> None:
        """Bring the last messages to the disk when no others follow them."""
        if not self._failed:
            try:
                self._writer.flush()
            except BagError as error:
                self._fail(error)

    def _fail(self, error: BagError) -> None:
        self._failed = True
        self.diagnostics.report(ERROR, str(error))


def _matches(topic: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(topic, pattern) for pattern in patterns)


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
