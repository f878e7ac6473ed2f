# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The status of a node on /diagnostics, time and again; each change is logged once."""

from collections import Counter
from collections.abc import Callable
import re
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from startracker_ros.ros.parameters import declare_one
from std_msgs.msg import Header

TaskResult = tuple[bytes, str, dict[str, object]]
"""Level, message and values of a status."""

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

_TICKS = 2
_MAX_EVENTS = 5
_NOTHING = 'nothing received yet'
# A timer tick that is later means that the process was busy or stopped.
_LATE_S = 0.4

_NUMBER = re.compile(r'[-+]?\d+(\.\d+)?([eE][-+]?\d+)?')


def status_message(name: str, hardware_id: str, level: bytes, message: str,
                   values: dict[str, object]) -> DiagnosticStatus:
    """Return one DiagnosticStatus with values as text."""
    return DiagnosticStatus(
        name=name, hardware_id=hardware_id, level=level, message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


class Diagnostics:
    """
    Collects the condition, events, counters and values of one node and publishes them.

    The functions in checks are called before each publication; tasks are further statuses by
    name. describe() returns values of the newest frame: it is called for a publication only.
    """

    def __init__(self, node: Node, task: str, hardware_id: str) -> None:
        self._node = node
        self._task = task
        # As those of diagnostic_updater. A status of 3 s ago is old to telemetry_bridge.
        self._node_name = (node.get_fully_qualified_name() if declare_one(
            node, False, ParameterDescriptor(
                name='diagnostic_updater.use_fqn', read_only=True, description='names of '
                'diagnostics begin with the namespace of the node, for an aggregator of several '
                'star trackers')) else node.get_name())
        self._tick_period_s = declare_one(node, 1.0, ParameterDescriptor(
            name='diagnostic_updater.period', read_only=True, description='period of the '
            'diagnostics [s]', floating_point_range=[
                FloatingPointRange(from_value=0.1, to_value=2.0)])) / _TICKS
        self._hardware_id = hardware_id
        self._condition = self._worst = (WARN, _NOTHING)
        self._events: list[str] = []
        self._transitions = Transitions()
        self.counts: Counter[str] = Counter()
        self.values: dict[str, object] = {}
        self.describe: Callable[[], dict[str, object]] = dict
        self.checks: list[Callable[[], None]] = []
        self.tasks: dict[str, Callable[[], TaskResult]] = {}
        self._logged_event = ''
        self._held = False
        self._ticks = 0
        self._tick_s: float | None = None
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # The steady clock: diagnostics continue while simulated time is stopped.
        self._timer = node.create_timer(self._tick_period_s, self._tick, clock=Clock(
            clock_type=ClockType.STEADY_TIME))

    def hold(self, message: str) -> None:
        """Report why the node is not active, and nothing else until release()."""
        self._held = False
        self.report(WARN, message, expected=True)
        self._held = True

    def release(self) -> None:
        """Report again what the node reports."""
        if self._held:
            self._held = False
            self.report(WARN, _NOTHING, expected=True)

    def report(self, level: bytes, message: str, *, expected: bool = False) -> None:
        """
        Set the condition; a change is logged once, repeats with other numbers are not.

        expected: what every start goes through is logged as information, whatever its level.
        """
        if self._held or (level, message) == self._condition:
            return
        self._condition = level, message
        # The newer one of two with the same level.
        self._worst = max(self._condition, self._worst, key=lambda condition: condition[0])
        line = self._transitions.line(level, message, time.monotonic())
        if line is not None:
            logger = self._node.get_logger()
            # One call each: rclpy allows one severity per line of code.
            if level == ERROR:
                logger.error(line)
            elif level == WARN and not expected:
                logger.warning(line)
            else:
                logger.info(line)

    def report_event(self, message: str, *, expected: bool = False) -> None:
        """
        Warn once, in the next publication; the condition does not change; expected as above.

        Of too many events the first of those is left out that differ in their numbers alone.
        """
        if self._held:
            return
        if message not in self._events:
            self._events.append(message)
            if len(self._events) > _MAX_EVENTS:
                kinds = [_NUMBER.sub('#', event) for event in self._events]
                del self._events[next((i for i, kind in enumerate(kinds)
                                       if kinds.count(kind) > 1), 0)]
        if message != self._logged_event:
            self._logged_event = message
            if expected:
                self._node.get_logger().info(message, throttle_duration_sec=1.0)
            else:
                self._node.get_logger().warning(message, throttle_duration_sec=1.0)

    def _tick(self) -> None:
        """Publish at every second tick; report a late one."""
        now_s = time.monotonic()
        late_s = 0.0 if self._tick_s is None else now_s - self._tick_s - self._tick_period_s
        self._tick_s = now_s
        if late_s > _LATE_S:
            self.report_event(f'busy or stopped for {late_s:.1f} s')
        self._ticks += 1
        if self._ticks % _TICKS == 0:
            self.publish()

    def publish(self) -> None:
        """Publish the worst condition and the events since the last time, counters, values."""
        for check in self.checks:
            check()
        self.values.update(self.describe())
        (level, message), events = self._worst, self._events
        self._worst, self._events = self._condition, []
        if events:
            message = '; '.join(events if level == OK else [message, *events])
            level = max(level, WARN)
        results = {self._task: (level, message, {**self.counts, **self.values})}
        for task, run in self.tasks.items():
            # It runs in any case, to begin its next window.
            task_level, task_message, values = run()
            results[task] = (*self._condition, {}) if self._held else (
                task_level, task_message, values)
        self._publisher.publish(DiagnosticArray(
            header=Header(stamp=self._node.get_clock().now().to_msg()),
            status=[status_message(f'{self._node_name}: {task}', self._hardware_id, *result)
                    for task, result in results.items()]))


class Transitions:
    """
    Separates changes of a condition from repeats, which differ in their numbers at most.

    A condition that alternates with every frame must not flood the log: after a burst of lines,
    one line in period_s is logged, with the number of changes left out before it.
    """

    def __init__(self, *, burst: int = 10, period_s: float = 1.0) -> None:
        self._burst = self._allowance = float(burst)
        self._period_s = period_s
        self._condition: tuple[object, str] | None = None
        self._suppressed = 0
        self._newest_s: float | None = None

    def line(self, level: object, text: str, now_s: float) -> str | None:
        """Return the line to log for a condition at a time of the steady clock, if any."""
        condition = level, _NUMBER.sub('#', text)
        if condition == self._condition:
            return None
        self._condition = condition
        if self._newest_s is not None:
            gained = (now_s - self._newest_s) / self._period_s
            self._allowance = min(self._burst, self._allowance + gained)
        self._newest_s = now_s
        if self._allowance < 1:
            self._suppressed += 1
            return None
        self._allowance -= 1
        suppressed, self._suppressed = self._suppressed, 0
        return f'{text} ({suppressed} changes before were not logged)' if suppressed else text
