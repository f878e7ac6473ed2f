# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""bag_player: an MCAP bag -> what it holds, and /clock."""

from functools import partial
import sys

from rosgraph_msgs.msg import Clock as ClockMessage
from startracker_ros.io.bags.playback import Playback, PlaybackOptions, PlayOptions
from startracker_ros.io.bags.reader import BagMessage
from startracker_ros.ros.bag_qos import playback_qos
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.messages.header import stamp_from_ns
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.ros.node import main_of, PipelineNode
from startracker_ros.ros.player_steps import (
    advertise_controls, AwaitedSubscribers, CAMERA_INFO, first_cameras, held_by_latched,
    open_playable, summary, wait_for_subscribers)


class BagPlayerNode(PipelineNode):
    """
    Publishes serialized messages at the pace of the recording, then ends.

    The status of the process is 1 where the bag could not be read to its end, or nothing of it
    was played.
    """

    option_classes = (PlayOptions, PlaybackOptions)
    task = 'playing'
    sends_images = True

    def __init__(self) -> None:
        super().__init__('bag_player')
        self._playback: Playback | None = None
        self._damaged = self._deactivated = False
        advertise_controls(self, lambda: self._playback)

    def rebuild(self) -> None:
        options, timing = self.options(PlayOptions), self.options(PlaybackOptions)
        bag, span_ns, chosen = open_playable(
            options, on_damage=self._on_damage, warn=self.get_logger().warning,
            own_clock=timing.clock_rate_hz > 0)
        self._players = {
            topic.name: self.advertise(
                message_class(topic.type_name), topic.name, playback_qos(topic.qos))
            # That of the cameras last, which tells when its users know those before.
            for topic in sorted(chosen, key=lambda topic: topic.type_name == CAMERA_INFO)}
        if timing.clock_rate_hz:
            self._clock_publisher = self.create_publisher(ClockMessage, '/clock', 10)
        playback = self._playback = Playback(
            partial(bag.messages, tuple(self._players)), span_ns, timing,
            publish=self._publish_message, tick=self._publish_clock, finished=self._on_end,
            held=partial(held_by_latched, bag, chosen, timing.latched))
        self._awaited = AwaitedSubscribers(
            self._players, first_cameras(bag, chosen, playback.time_ns), options, self)
        self._timer = self.create_steady_timer(0.01, partial(self._start, playback))

    def activate(self) -> None:
        if self._deactivated and self._playback is not None:
            self._playback.resume()

    def deactivate(self) -> None:
        # Not resumed if ~/pause has paused it.
        self._deactivated = self._playback is not None and self._playback.pause()

    def cleanup(self) -> None:
        if self._playback is not None:
            self._playback.stop()
        self._playback, self._deactivated = None, False
        self._awaited.close()
        self.destroy_timer(self._timer)
        for publisher in self._players.values():
            self.destroy_publisher(publisher)

    def close(self) -> None:
        """Stop the playback."""
        if self._playback is not None:
            self._playback.stop()
            print(f'[bag_player] {self.options(PlayOptions).path}: '
                  f'{summary(self._playback, len(self._players))}', file=sys.stderr, flush=True)

    def _on_damage(self, problem: str) -> None:
        """Report the first damage as the condition of the node, more in the log."""
        if self._damaged:
            self.get_logger().error(problem)
        else:
            self._damaged = True
            self.diagnostics.report(ERROR, problem)

    def _start(self, playback: Playback) -> None:
        if self.active and self._awaited.are_there():
            self._awaited.close()
            self.destroy_timer(self._timer)
            self._timer = self.create_steady_timer(0.5, partial(self._report, playback))
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
        problem = '' if failure is None else str(failure) or repr(failure)
        if self._playback is not None:
            problem = problem or self._playback.why_nothing
        if problem:
            self.get_logger().error(problem)
        if not self.configured:
            return
        wait_for_subscribers(self._players.values())
        self.shutdown.request(int(bool(problem)))


main = main_of(BagPlayerNode)

if __name__ == '__main__':
    main()
