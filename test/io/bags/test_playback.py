# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pace of a playback without ROS: nothing comes early or out of turn."""

from collections.abc import Iterator
import sys
import threading
import time

from limits import HANGS_S
import pytest
from startracker_ros.io.bags.playback import Playback, PlaybackOptions
from startracker_ros.io.bags.reader import BagMessage

START_NS = 1_700_000_000_000_000_000
MESSAGES = [BagMessage('/a', 'std_msgs/msg/String', bytes([number]), START_NS + number * 10 ** 7,
                       0) for number in range(30)]
SPAN_NS = (MESSAGES[0].log_time_ns, MESSAGES[-1].log_time_ns)


class Listener:
    """Notes what is played and when."""

    def __init__(self, options: PlaybackOptions, messages: list[BagMessage] = MESSAGES,
                 failure: Exception | None = None) -> None:
        self.played: list[tuple[float, BagMessage]] = []
        self.ticks: list[int] = []
        self.ended = threading.Event()
        self.failure: Exception | None = None
        self._messages, self._fails = messages, failure
        self.playback = Playback(
            self._read, SPAN_NS, options, publish=self._publish, tick=self.ticks.append,
            finished=self._finish)

    def _read(self, start_ns: int) -> Iterator[BagMessage]:
        yield from (message for message in self._messages if message.log_time_ns >= start_ns)
        if self._fails is not None:
            raise self._fails

    def _publish(self, message: BagMessage) -> None:
        self.played.append((time.monotonic(), message))

    def _finish(self, failure: Exception | None) -> None:
        self.failure = failure
        self.ended.set()

    def numbers(self) -> list[int]:
        return [message.data[0] for _, message in self.played]

    def wait_for(self, count: int) -> None:
        deadline_s = time.monotonic() + HANGS_S
        while len(self.played) < count:
            assert time.monotonic() < deadline_s
            time.sleep(0.002)


def run(**options: object) -> Listener:
    listener = Listener(PlaybackOptions(**options))
    listener.playback.start()
    assert listener.ended.wait(HANGS_S)
    assert listener.failure is None
    return listener


@pytest.mark.parametrize('rate', [1.0, 4.0])
def test_no_message_is_early(rate: float) -> None:
    listener = run(rate=rate)
    assert listener.numbers() == list(range(30))
    assert listener.playback.published == 30
    first_s = listener.played[0][0]
    late_s = [at_s - first_s - (message.log_time_ns - START_NS) * 1e-9 / rate
              for at_s, message in listener.played]
    # The first may itself be late, which makes all others look early.
    assert min(late_s) >= -1e-3 - listener.playback.errors_s[0]
    assert min(listener.playback.errors_s) >= 0


def test_a_part_is_played() -> None:
    assert run(start_offset_s=0.1, duration_s=0.05).numbers() == [10, 11, 12, 13, 14, 15]
    assert run(start_offset_s=10.0).numbers() == []


def test_the_clock_runs_over_the_span_and_is_never_ahead() -> None:
    listener = run(rate=0.5, clock_rate_hz=200.0)
    assert listener.ticks == sorted(listener.ticks)
    assert listener.ticks[0] >= START_NS and listener.ticks[-1] <= SPAN_NS[1] + 10 ** 6
    assert len(listener.ticks) > 1
    assert run(clock_rate_hz=0.0).ticks == []


def test_a_loop_begins_again_until_it_is_stopped() -> None:
    listener = Listener(PlaybackOptions(loop=True, rate=100.0))
    listener.playback.start()
    listener.wait_for(100)
    listener.playback.stop()
    assert listener.ended.wait(HANGS_S)
    numbers = listener.numbers()
    assert numbers == [number % 30 for number in range(len(numbers))]


def test_pause_step_resume() -> None:
    listener = Listener(PlaybackOptions(start_paused=True))
    playback = listener.playback
    playback.start()
    assert playback.paused and not playback.pause()
    for count in (1, 2, 3):
        assert playback.step()
        listener.wait_for(count)
    time.sleep(0.1)
    assert listener.numbers() == [0, 1, 2]
    assert listener.ticks == [message.log_time_ns for message in MESSAGES[:3]]
    assert playback.time_ns == MESSAGES[2].log_time_ns
    assert playback.resume() and not playback.resume()
    assert not playback.step()
    listener.wait_for(10)
    assert playback.pause()
    time.sleep(0.5)
    count, time_ns = len(listener.played), playback.time_ns
    time.sleep(0.1)
    assert (len(listener.played), playback.time_ns) == (count, time_ns)
    playback.resume()
    assert listener.ended.wait(HANGS_S)
    assert listener.numbers() == list(range(30))
    assert min(playback.errors_s) >= 0


def test_messages_out_of_order_are_played_when_they_are_read() -> None:
    mixed = [MESSAGES[number] for number in (0, 2, 1, 4, 3)]
    listener = Listener(PlaybackOptions(), mixed)
    listener.playback.start()
    assert listener.ended.wait(HANGS_S)
    assert listener.numbers() == [0, 2, 1, 4, 3]


def test_its_pace_is_asked_for_while_it_plays() -> None:
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        listener = Listener(PlaybackOptions(rate=1000.0), [MESSAGES[0]] * 20_000)
        listener.playback.start()
        deadline_s = time.monotonic() + HANGS_S
        while not listener.ended.is_set():
            assert time.monotonic() < deadline_s
            listener.playback.pacing_ms()
    finally:
        sys.setswitchinterval(interval_s)
    assert listener.failure is None and len(listener.played) == 20_000


def test_a_failure_of_reading_ends_it_by_name() -> None:
    listener = Listener(PlaybackOptions(), MESSAGES[:5], RuntimeError('the disk was pulled out'))
    listener.playback.start()
    assert listener.ended.wait(HANGS_S)
    assert str(listener.failure) == 'the disk was pulled out'
    assert listener.numbers() == [0, 1, 2, 3, 4]


def test_an_offset_behind_the_end_is_named_and_a_stop_is_not() -> None:
    assert run(start_offset_s=5.0, duration_s=2.0).playback.why_nothing == (
        'nothing was played: no message from 5 s on for 2 s; the bag ends at 0.29 s')
    paused = Listener(PlaybackOptions(start_paused=True))
    paused.playback.start()
    paused.playback.stop()
    assert paused.ended.wait(HANGS_S) and paused.playback.why_nothing == ''
    assert run().playback.why_nothing == ''
