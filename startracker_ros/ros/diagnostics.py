"""What a node tells about itself on /diagnostics, once a second."""

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def status_message(name: str, hardware_id: str, level: bytes, message: str,
                   values: dict[str, object]) -> DiagnosticStatus:
    """Return one DiagnosticStatus with values as text."""
    return DiagnosticStatus(
        name=name, hardware_id=hardware_id, level=level, message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


class Diagnostics:
    """Collects the condition, counters and last values of one node and publishes them."""

    def __init__(self, node: Node, task: str, hardware_id: str) -> None:
        self._node = node
        self._name = f'{node.get_name()}: {task}'
        self._hardware_id = hardware_id
        self._condition = self._worst = (WARN, 'nothing received yet')
        self.counts: Counter[str] = Counter()
        self.values: dict[str, object] = {}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # The steady clock: diagnostics must go on when simulated time stands still.
        self._timer = node.create_timer(1.0, self.publish, clock=Clock(
            clock_type=ClockType.STEADY_TIME))

    def report(self, level: bytes, message: str) -> None:
        """Set the condition; a change is logged once, repeats are not."""
        if (level, message) == self._condition:
            return
        recovered = level == OK and self._condition[0] != OK
        self._condition = level, message
        # Of two as bad the newer one.
        self._worst = max(self._condition, self._worst, key=lambda condition: condition[0])
        logger = self._node.get_logger()
        if level == ERROR:
            logger.error(message, throttle_duration_sec=1.0)
        elif level == WARN:
            logger.warning(message, throttle_duration_sec=1.0)
        elif recovered:
            logger.info(message)

    def publish(self) -> None:
        """Publish the worst condition since the last time, with all counters and values."""
        level, message = self._worst
        self._worst = self._condition
        status = status_message(self._name, self._hardware_id, level, message,
                                {**self.counts, **self.values})
        self._publisher.publish(DiagnosticArray(
            header=Header(stamp=self._node.get_clock().now().to_msg()), status=[status]))
