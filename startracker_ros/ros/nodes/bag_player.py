"""bag_player: an MCAP bag -> what it holds, and /clock."""

from functools import partial
from pathlib import Path
import sys
import time

from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock as ClockMessage
from startracker_ros.bag.errors import BagError
from startracker_ros.bag.playback import Playback, PlaybackOptions, PlayOptions
from startracker_ros.bag.reader import BagMessage
from startracker_ros.bag.tolerant import TolerantBag
from startracker_ros.ros.awaited_subscribers import AwaitedSubscribers
from startracker_ros.ros.bag_qos import playback_qos
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.node import main_of, PipelineNode, StartError
from startracker_ros.ros.playable import playable_topics

# For subscribers to acknowledge the last messages.
_LAST_MESSAGES_S = 2.0


class BagPlayerNode(PipelineNode):
    """Publishes serialized messages at the pace of the recording, then ends."""

    option_classes = (PlayOptions, PlaybackOptions)
    task = 'playing'

    def __init__(self) -> None:
        super().__init__('bag_player')
        self._playback: Playback | None = None
        self._damaged = False

    def rebuild(self) -> None:
        options, timing = self.options(PlayOptions), self.options(PlaybackOptions)
        if not options.path:
            raise StartError('path is empty: name a bag folder or an .mcap file')
        try:
            bag = TolerantBag(Path(options.path), self._on_damage)
        except BagError as error:
            raise StartError(str(error)) from error
        chosen = playable_topics(bag.topics.values(), options, warn=self.get_logger().warning,
                                 own_clock=timing.clock_rate_hz > 0)
        if bag.span_ns is None or not chosen:
            raise StartError(f'{options.path}: nothing to play among '
                             f'{", ".join(sorted(bag.topics)) or "no topics"}')
        self._players = {
            topic.name: self.create_publisher(
                message_class(topic.type_name), topic.name, playback_qos(topic.qos))
            for topic in chosen}
        if timing.clock_rate_hz:
            self._clock_publisher = self.create_publisher(ClockMessage, '/clock', 10)
        playback = self._playback = Playback(
            partial(bag.messages, tuple(self._players)), bag.span_ns, timing,
            publish=self._publish_message, tick=self._publish_clock, finished=self._on_end)
        self.advertise_trigger('pause', lambda: (playback.pause(), 'paused'))
        self.advertise_trigger('resume', lambda: (playback.resume(), 'playing'))
        self.advertise_trigger('step', lambda: (
            (True, 'one message more') if playback.step() else (False, 'not paused: pause first')))
        self._start_timer = self.create_steady_timer(0.01, partial(
            self._start, playback, AwaitedSubscribers(self._players, options, self)))

    def close(self) -> None:
        """Stop the playback."""
        if self._playback is not None:
            self._playback.stop()
            median, p95, worst = self._playback.pacing_ms()
            print(f'[bag_player] {self.options(PlayOptions).path}: {self._playback.published} '
                  f'messages of {len(self._players)} topics; late by {median:.2f} ms median, '
                  f'{p95:.2f} ms p95, {worst:.2f} ms at most', file=sys.stderr, flush=True)

    def _on_damage(self, problem: str) -> None:
        """Report the first damage as the condition of the node, more in the log."""
        if self._damaged:
            self.get_logger().error(problem)
        else:
            self._damaged = True
            self.diagnostics.report(ERROR, problem)

    def _start(self, playback: Playback, awaited: AwaitedSubscribers) -> None:
        if awaited.are_there():
            self.destroy_timer(self._start_timer)
            self.create_steady_timer(0.5, partial(self._report, playback))
            playback.start()

    def _publish_message(self, message: BagMessage) -> None:
        # A truncated bag may name a topic that its index did not.
        if publisher := self._players.get(message.topic):
            publisher.publish(message.data)
            self.diagnostics.counts['messages'] += 1

    def _publish_clock(self, time_ns: int) -> None:
        self._clock_publisher.publish(ClockMessage(clock=stamp_from_ns(time_ns)))

    def _report(self, playback: Playback) -> None:
        median, p95, _ = playback.pacing_ms()
        self.diagnostics.values.update({
            'bag_time': f'{playback.time_ns * 1e-9:.3f}',
            'late_median_ms': f'{median:.3f}', 'late_p95_ms': f'{p95:.3f}'})
        if not self._damaged:
            self.diagnostics.report(*((WARN, 'paused') if playback.paused else (
                OK, f'playing {len(self._players)} topics')))

    def _on_end(self, failure: Exception | None) -> None:
        """End the node with the bag; runs in the thread of the playback."""
        if failure is not None:
            self.get_logger().error(str(failure))
        end_s = time.monotonic() + _LAST_MESSAGES_S
        for publisher in self._players.values():
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, end_s - time.monotonic())))
        self.shutdown.request()


main = main_of(BagPlayerNode)

if __name__ == '__main__':
    main()
