# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Plays messages at the pace they were recorded at, without ROS."""

from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
import threading
import time

import numpy as np
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.reader import BagMessage

_AHEAD_BYTES = 2 ** 26
_AHEAD_MESSAGES = 1000
# Bounds the memory of errors_s: 1000 s at 1 kHz.
_MAX_ERRORS = 10 ** 6


@dataclass(frozen=True)
class PlaybackOptions(Options):
    """Which part of a bag is played, and how."""

    rate: float = option(1.0, 'times as fast as recorded', low=0.01, high=1000.0, read_only=True)
    start_offset_s: float = option(
        0.0, 'recorded time left out at the beginning', unit='s', low=0.0, high=1e9,
        read_only=True)
    latched: bool = option(
        False, 'publish first what latched (transient local) topics held at start_offset_s, as a '
        'subscriber of that time would have received it', read_only=True)
    duration_s: float = option(
        0.0, 'recorded time that is played, 0 for all', unit='s', low=0.0, high=1e9,
        read_only=True)
    loop: bool = option(False, 'begin again after the end', read_only=True)
    start_paused: bool = option(False, 'wait for ~/resume or ~/step', read_only=True)
    clock_rate_hz: float = option(
        100.0, '/clock messages a second, the time of recording, for nodes with use_sim_time; '
        '0 for none', unit='Hz', low=0.0, high=1000.0, read_only=True)


@dataclass(frozen=True)
class PlayOptions(Options):
    """What is played."""

    path: str = option('', 'bag folder or .mcap file', read_only=True)
    topics: tuple[str, ...] = option(('*',), 'patterns of full topic names, * for any characters',
                                     read_only=True)
    exclude: tuple[str, ...] = option(
        ('/parameter_events', '/rosout', '*/transition_event'), 'patterns of topics left out; '
        'these would pass for those of running nodes', read_only=True)
    wait_for_subscribers: int = option(
        1, 'matched subscribers of each topic to wait for before the first message, 0 not to wait',
        low=0, high=100, read_only=True)
    wait_for_camera_users: int = option(
        0, 'users of camera_info to wait for: every stage of the pipeline is one, once it has '
        'loaded its code and found the stage before it; stages that subscribe are awaited in any '
        'case; they receive the first camera_info, and the bag begins when their diagnostics say '
        'that they are set up for this camera', low=0, high=100, read_only=True)
    wait_limit_s: float = option(
        3.0, 'time after which the bag is played without subscribers that are missing',
        unit='s', low=0.0, high=3600.0, read_only=True)
    start_delay_s: float = option(
        0.3, 'time from the last awaited subscriber to the first message, as a subscriber may '
        'find the topic a little later than it is found', unit='s',
        low=0.0, high=3600.0, read_only=True)


class Playback:
    """
    Calls publish(message) when each message is due and tick(time_ns) as a clock, in a thread.

    read(start_ns) yields the messages from a log time on, once for each pass; span_ns is the
    first and last log time of the bag. held(start_ns) returns what is published first, before the
    pace of the recording begins. finished is called at the end, with the exception that
    ended it or None. published counts messages; errors_s is the lateness of each one.
    """

    def __init__(self, read: Callable[[int], Iterator[BagMessage]], span_ns: tuple[int, int],
                 options: PlaybackOptions, *, publish: Callable[[BagMessage], None],
                 tick: Callable[[int], None],
                 finished: Callable[[Exception | None], None],
                 held: Callable[[int], Iterable[BagMessage]] = lambda start_ns: ()) -> None:
        self._read = read
        self._options = options
        self._publish = publish
        self._tick = tick
        self._finished = finished
        self._held = held
        self._span_ns = span_ns
        self._begin_ns = span_ns[0] + round(options.start_offset_s * 1e9)
        self._end_ns = (self._begin_ns + round(options.duration_s * 1e9)
                        if options.duration_s else span_ns[1])
        self._changed = threading.Condition()
        self._steps = 0
        self._stopped = False
        # Bag time and monotonic time of one instant; while paused the bag time is fixed.
        self._origin_ns = self._begin_ns
        self._origin_s = 0.0
        self._paused = options.start_paused
        self._next_tick_s = 0.0
        self.published = 0
        self.errors_s = array('d')
        self._thread = threading.Thread(target=self._run, name='bag playback', daemon=True)

    def start(self) -> None:
        """Start the thread; once only."""
        self._thread.start()

    def stop(self) -> None:
        """Stop after the current message."""
        with self._changed:
            self._stopped = True
            self._changed.notify()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()

    @property
    def paused(self) -> bool:
        """Whether playback is paused."""
        return self._paused

    @property
    def time_ns(self) -> int:
        """Return the time of recording that is played now."""
        if self._paused or not self._origin_s:
            return self._origin_ns
        elapsed_s = time.monotonic() - self._origin_s
        return self._origin_ns + round(elapsed_s * self._options.rate * 1e9)

    def pause(self) -> bool:
        """Pause; return False if it is paused."""
        with self._changed:
            if self._paused:
                return False
            self._origin_ns = self.time_ns
            self._paused = True
            self._changed.notify()
            return True

    def resume(self) -> bool:
        """Resume; return False if it is not paused."""
        with self._changed:
            if not self._paused:
                return False
            self._paused = False
            self._origin_s = time.monotonic()
            self._steps = 0
            self._changed.notify()
            return True

    def step(self) -> bool:
        """Play the next message and stay paused; return False if it is not paused."""
        with self._changed:
            if self._paused:
                self._steps += 1
                self._changed.notify()
            return self._paused

    def pacing_ms(self) -> tuple[float, float, float]:
        """Return median, 95th percentile and largest lateness of the messages played."""
        # An array that NumPy reads cannot grow meanwhile.
        with self._changed:
            errors = 1e3 * np.array(self.errors_s)
        return tuple(np.percentile(errors, (50, 95, 100))) if len(errors) else (0.0, 0.0, 0.0)

    @property
    def why_nothing(self) -> str:
        """Why a playback that has ended published nothing, empty where it did or was stopped."""
        if self.published or self._stopped:
            return ''
        options, (begin_ns, end_ns) = self._options, self._span_ns
        limit = f' for {options.duration_s:g} s' if options.duration_s else ''
        return (f'nothing was played: no message from {options.start_offset_s:g} s on{limit}; the '
                f'bag ends at {(end_ns - begin_ns) * 1e-9:g} s')

    def _run(self) -> None:
        failure = None
        try:
            while not self._stopped and self._play_once() and self._options.loop:
                pass
        except Exception as error:
            # A thread has no caller: the exception goes to finished().
            failure = error
        self._finished(failure)

    def _play_once(self) -> bool:
        """Play from begin to end; return whether a message was published."""
        for message in self._held(self._begin_ns):
            self._publish(message)
            self.published += 1
        before = self.published
        ahead = _ReadAhead(self._read(self._begin_ns), self._end_ns)
        try:
            first = True
            for message in ahead:
                if first:
                    with self._changed:
                        self._origin_ns = self._begin_ns
                        self._origin_s = self._next_tick_s = time.monotonic()
                    first = False
                if not self._wait_until(message.log_time_ns):
                    break
                self._publish(message)
                self.published += 1
            # Wait to the end of the span, also after the last message.
            if not first and not self._stopped:
                self._wait_until(self._end_ns)
        finally:
            ahead.close()
        return self.published > before

    def _wait_until(self, due_ns: int) -> bool:
        """Wait until a bag time is due, ticking the clock; False when playback is stopped."""
        while True:
            with self._changed:
                if self._stopped:
                    return False
                if self._paused:
                    if not self._steps:
                        self._changed.wait()
                        continue
                    self._steps -= 1
                    self._origin_ns = max(self._origin_ns, due_ns)
                    tick_ns, stepped = self._origin_ns, True
                else:
                    now_s = time.monotonic()
                    due_s = self._origin_s + (due_ns - self._origin_ns) * 1e-9 / self._options.rate
                    if now_s >= due_s:
                        if len(self.errors_s) < _MAX_ERRORS:
                            self.errors_s.append(now_s - due_s)
                        return True
                    if not self._options.clock_rate_hz or now_s < self._next_tick_s:
                        wake_s = min(due_s, self._next_tick_s) if (
                            self._options.clock_rate_hz) else due_s
                        self._changed.wait(wake_s - now_s)
                        continue
                    self._next_tick_s = max(
                        self._next_tick_s + 1 / self._options.clock_rate_hz, now_s)
                    tick_ns, stepped = self.time_ns, False
            if self._options.clock_rate_hz:
                self._tick(tick_ns)
            if stepped:
                return True


class _ReadAhead:
    """Reads messages in a thread, ahead of playback."""

    def __init__(self, messages: Iterator[BagMessage], end_ns: int) -> None:
        self._messages = messages
        self._end_ns = end_ns
        self._queue: deque[BagMessage] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._closed = False
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._fill, name='bag reader', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def __iter__(self) -> Iterator[BagMessage]:
        while True:
            with self._changed:
                while not self._queue and not self._closed:
                    self._changed.wait()
                if not self._queue:
                    if self._failure is not None:
                        raise self._failure
                    return
                message = self._queue.popleft()
                self._bytes -= len(message.data)
                self._changed.notify_all()
            yield message

    def _fill(self) -> None:
        try:
            for message in self._messages:
                if message.log_time_ns > self._end_ns:
                    if message.log_time_ns > self._end_ns + DISORDER_NS:
                        return
                    continue
                with self._changed:
                    while not self._closed and self._queue and (
                            self._bytes >= _AHEAD_BYTES or len(self._queue) >= _AHEAD_MESSAGES):
                        self._changed.wait()
                    if self._closed:
                        return
                    self._queue.append(message)
                    self._bytes += len(message.data)
                    self._changed.notify_all()
        except Exception as error:
            self._failure = error
        finally:
            with self._changed:
                self._closed = True
                self._changed.notify_all()


# --- what latched (transient local) topics held at a time of a recording ---

MAX_DEPTH = 10_000
"""Messages of a topic, whatever its publishers offered."""

# Unfinished bags are read in the order of writing, which is nearly that of time.
DISORDER_NS = 10 ** 9


def held_messages(offers: Iterable[QosProfile]) -> int:
    """
    Return how many messages the publishers of a topic hold for late subscribers.

    A recorder does not know the depth of a publisher over DDS: one message is assumed.
    """
    latched = [offer for offer in offers if offer.durability == 'transient_local']
    return min(MAX_DEPTH, sum(
        MAX_DEPTH if offer.history == 'keep_all' else max(1, offer.depth) for offer in latched))


def held_before(messages: Iterable[BagMessage], held: dict[str, int], time_ns: int
                ) -> list[BagMessage]:
    """Return the last messages before a log time, held[topic] of each topic, oldest first."""
    last: dict[str, deque[BagMessage]] = {
        topic: deque(maxlen=count) for topic, count in held.items()}
    for message in messages:
        if message.log_time_ns >= time_ns + DISORDER_NS:
            break
        if message.log_time_ns < time_ns:
            last[message.topic].append(message)
    return sorted((message for some in last.values() for message in some),
                  key=lambda message: message.log_time_ns)
