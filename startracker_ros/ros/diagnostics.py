"""What a node tells about itself on /diagnostics, once a second."""

from collections import Counter
from collections.abc import Callable
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from startracker_ros.ros.transitions import Transitions
from std_msgs.msg import Header

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

_BEATS = 2
_BEAT_S = 1.0 / _BEATS
_MOST_NOTES = 5
# So much later than it should is a beat that tells of something.
_LATE_S = 0.4


def status_message(name: str, hardware_id: str, level: bytes, message: str,
                   values: dict[str, object]) -> DiagnosticStatus:
    """Return one DiagnosticStatus with values as text."""
    return DiagnosticStatus(
        name=name, hardware_id=hardware_id, level=level, message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


class Diagnostics:
    """
    Collects the condition, counters and last values of one node and publishes them.

    checks are called before each publication.
    """

    def __init__(self, node: Node, task: str, hardware_id: str) -> None:
        self._node = node
        self._name = f'{node.get_name()}: {task}'
        self._hardware_id = hardware_id
        self._condition = self._worst = (WARN, 'nothing received yet')
        self._notes: list[str] = []
        self._transitions = Transitions()
        self.counts: Counter[str] = Counter()
        self.values: dict[str, object] = {}
        self.checks: list[Callable[[], None]] = []
        self._noted = ''
        self._beats = 0
        self._beat_s: float | None = None
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # The steady clock: diagnostics must go on when simulated time stands still.
        self._timer = node.create_timer(_BEAT_S, self._beat, clock=Clock(
            clock_type=ClockType.STEADY_TIME))

    def report(self, level: bytes, message: str) -> None:
        """Set the condition; a change is logged once, repeats with other numbers are not."""
        if (level, message) == self._condition:
            return
        self._condition = level, message
        # Of two as bad the newer one.
        self._worst = max(self._condition, self._worst, key=lambda condition: condition[0])
        line = self._transitions.line(level, message, time.monotonic())
        if line is not None:
            logger = self._node.get_logger()
            # One place each: rclpy ties a severity to the line of the code that logs.
            if level == ERROR:
                logger.error(line)
            elif level == WARN:
                logger.warning(line)
            else:
                logger.info(line)

    def note(self, message: str) -> None:
        """Warn of what has happened, in the next publication only; the condition stays."""
        if message not in self._notes:
            self._notes = [*self._notes, message][-_MOST_NOTES:]
        if message != self._noted:
            self._noted = message
            self._node.get_logger().warning(message, throttle_duration_sec=1.0)

    def _beat(self) -> None:
        """Publish at every second beat; a beat that came late was kept from coming."""
        now_s = time.monotonic()
        late_s = 0.0 if self._beat_s is None else now_s - self._beat_s - _BEAT_S
        self._beat_s = now_s
        if late_s > _LATE_S:
            self.note(f'busy or stopped for {late_s:.1f} s')
        self._beats += 1
        if self._beats % _BEATS == 0:
            self.publish()

    def publish(self) -> None:
        """Publish the worst condition and the notes since the last time, counters, values."""
        for check in self.checks:
            check()
        (level, message), notes = self._worst, self._notes
        self._worst, self._notes = self._condition, []
        if notes:
            message = '; '.join(notes if level == OK else [message, *notes])
            level = max(level, WARN)
        status = status_message(self._name, self._hardware_id, level, message,
                                {**self.counts, **self.values})
        self._publisher.publish(DiagnosticArray(
            header=Header(stamp=self._node.get_clock().now().to_msg()), status=[status]))
