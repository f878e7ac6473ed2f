"""bag_player: an MCAP bag -> what it holds, and /clock."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from startracker_ros.bag.errors import BagError
from startracker_ros.bag.patterns import matches
from startracker_ros.bag.playback import Playback, PlaybackOptions
from startracker_ros.bag.qos import INFINITE_NS, QosProfile
from startracker_ros.bag.reader import (
    BagMessage, BagTopic, read_messages, read_span_ns, read_topics)
from startracker_ros.bag.schemas import message_schema
from startracker_ros.options import option, Options
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.node import main_of, PipelineNode, StartError
from std_srvs.srv import Trigger

# What history and depth are unknown of; DDS tells no subscriber of them.
_DEPTH = 100
# A bag may ask for more; memory is taken as messages come.
_MAX_DEPTH = 10_000
# So long at most subscribers have for what was published last.
_LAST_WORDS_S = 2.0
# Who reads more of them?
_MOST_PROBLEMS = 100


@dataclass(frozen=True)
class PlayOptions(Options):
    """What is played."""

    path: str = option('', 'bag folder or .mcap file', read_only=True)
    topics: tuple[str, ...] = option(('*',), 'patterns of full topic names, * for any characters',
                                     read_only=True)
    exclude: tuple[str, ...] = option(
        ('/parameter_events', '/rosout'), 'patterns of topics left out; these two would pass for '
        'those of running nodes', read_only=True)
    start_delay_s: float = option(
        1.0, 'time for subscribers to find the topics before the first message', unit='s',
        low=0.0, high=3600.0, read_only=True)


class BagPlayerNode(PipelineNode):
    """Publishes serialized messages at the pace of the recording, then ends."""

    option_classes = (PlayOptions, PlaybackOptions)
    task = 'playing'

    def __init__(self) -> None:
        super().__init__('bag_player')
        self._playback: Playback | None = None

    def configure(self) -> None:
        options = self.options(PlayOptions)
        if not options.path:
            raise StartError('path is empty: name a bag folder or an .mcap file')
        self._bag = Path(options.path)
        self._problems: set[str] = set()
        try:
            topics = self._read_topics()
            span_ns = read_span_ns(self._bag)
        except BagError as error:
            raise StartError(str(error)) from error
        chosen = [topic for topic in topics.values()
                  if matches(topic.name, options.topics)
                  and not matches(topic.name, options.exclude) and self._can_play(topic)]
        if span_ns is None or not chosen:
            raise StartError(f'{self._bag}: nothing to play among '
                             f'{", ".join(sorted(topics)) or "no topics"}')
        self._players = {topic.name: self._publisher(topic) for topic in chosen}
        if self.options(PlaybackOptions).clock_rate_hz:
            self._clock_publisher = self.create_publisher(ClockMessage, '/clock', 10)
        playback = self._playback = Playback(
            self._messages, span_ns, self.options(PlaybackOptions), publish=self._publish_message,
            tick=self._tick, finished=self._finish)
        for name, act, words in (
                ('pause', playback.pause, 'paused'),
                ('resume', playback.resume, 'playing'),
                ('step', playback.step, 'one message more')):
            self._offer(name, act, words)
        if not self._problems:
            self.diagnostics.report(OK, f'playing {len(chosen)} topics')
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._begin_timer = self.create_timer(
            max(options.start_delay_s, 1e-3), partial(self._begin, playback), clock=steady)
        self.create_timer(0.5, partial(self._report, playback), clock=steady)

    def close(self) -> None:
        """End the playback."""
        if self._playback is not None:
            self._playback.stop()
            median, p95, worst = self._playback.pacing_ms()
            print(f'[bag_player] {self._bag}: {self._playback.published} messages of '
                  f'{len(self._players)} topics; late by {median:.2f} ms median, '
                  f'{p95:.2f} ms p95, {worst:.2f} ms at most', file=sys.stderr, flush=True)

    def _read_topics(self) -> dict[str, BagTopic]:
        try:
            return read_topics(self._bag)
        except BagError as error:
            # What is whole is played all the same.
            topics = read_topics(self._bag, tolerant=True)
            self._tell(str(error))
            return topics

    def _tell(self, problem: str) -> None:
        """Report damage once, not each time round."""
        if problem in self._problems or len(self._problems) >= _MOST_PROBLEMS:
            return
        if self._problems:
            self.get_logger().error(problem)
        else:
            self.diagnostics.report(ERROR, problem)
        self._problems.add(problem)

    def _can_play(self, topic: BagTopic) -> bool:
        options = self.options(PlaybackOptions)
        reason = ''
        if topic.encoding != 'cdr':
            reason = f'its messages are {topic.encoding!r}, not cdr'
        elif topic.name == '/clock' and options.clock_rate_hz:
            reason = 'clock_rate_hz makes a new one'
        else:
            try:
                message_class(topic.type_name)
            except (ImportError, ValueError):
                reason = f'{topic.type_name or "a topic without a type"} is not installed'
            else:
                installed = message_schema(topic.type_name).type_hash
                if topic.schema.type_hash and installed not in ('', topic.schema.type_hash):
                    reason = f'{topic.type_name} was recorded with another definition'
        if reason:
            self.get_logger().warning(f'{topic.name} is not played: {reason}')
        return not reason

    def _publisher(self, topic: BagTopic) -> Publisher:
        return self.create_publisher(
            message_class(topic.type_name), topic.name, playback_qos(topic.qos))

    def _offer(self, name: str, act: Callable[[], bool], words: str) -> None:
        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success = act()
            response.message = words if response.success else (
                'playing' if name == 'resume' else 'paused' if name == 'pause' else
                'not paused: pause first')
            return response
        self.create_service(Trigger, f'~/{name}', answer)

    def _begin(self, playback: Playback) -> None:
        self.destroy_timer(self._begin_timer)
        playback.start()

    def _messages(self, start_ns: int) -> Iterator[BagMessage]:
        return read_messages(self._bag, topics=tuple(self._players), start_ns=start_ns,
                             tolerant=True, report=self._tell)

    def _publish_message(self, message: BagMessage) -> None:
        # A truncated bag may name a topic that its index did not.
        publisher = self._players.get(message.topic)
        if publisher is not None:
            publisher.publish(message.data)
            self.diagnostics.counts['messages'] += 1

    def _tick(self, time_ns: int) -> None:
        self._clock_publisher.publish(ClockMessage(clock=stamp_from_ns(time_ns)))

    def _report(self, playback: Playback) -> None:
        median, p95, _ = playback.pacing_ms()
        self.diagnostics.values.update({
            'bag_time': f'{playback.time_ns * 1e-9:.3f}',
            'late_median_ms': f'{median:.3f}', 'late_p95_ms': f'{p95:.3f}'})
        if not self._problems:
            self.diagnostics.report(*((WARN, 'paused') if playback.paused else (
                OK, f'playing {len(self._players)} topics')))

    def _finish(self, failure: Exception | None) -> None:
        """End the node when the bag is at its end; runs in the playback's thread."""
        if failure is not None:
            self.get_logger().error(str(failure))
        end_s = time.monotonic() + _LAST_WORDS_S
        for publisher in self._players.values():
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, end_s - time.monotonic())))
        self.ending.ask()


def playback_qos(offers: Sequence[QosProfile]) -> QoSProfile:
    """
    Return a profile that serves every subscriber the recorded publishers served.

    Deadline, lifespan and lease are promises of one publisher: they are kept if all gave the same.
    """
    profile = QoSProfile(depth=_DEPTH)
    if not offers:
        return profile
    known = [offer.depth for offer in offers if offer.history == 'keep_last' and offer.depth]
    profile.depth = min(max(1, *known), _MAX_DEPTH) if known else _DEPTH
    if all(offer.history == 'keep_all' for offer in offers):
        profile.history = HistoryPolicy.KEEP_ALL
    if all(offer.reliability == 'best_effort' for offer in offers):
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if any(offer.durability == 'transient_local' for offer in offers):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    first = offers[0]
    if all((offer.deadline_ns, offer.lifespan_ns) == (first.deadline_ns, first.lifespan_ns)
           for offer in offers):
        for name, value_ns in (('deadline', first.deadline_ns), ('lifespan', first.lifespan_ns)):
            if 0 < value_ns < INFINITE_NS:
                setattr(profile, name, Duration(nanoseconds=value_ns))
    return profile


main = main_of(BagPlayerNode)

if __name__ == '__main__':
    main()
