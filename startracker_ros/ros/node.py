"""What every node shares: options from parameters, diagnostics, a clean end."""

from collections.abc import Callable, Sequence
from functools import partial
import gc
from importlib import import_module
import sys
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from startracker_ros.bag.layouts import MessageError
from startracker_ros.camera.model import CameraError
from startracker_ros.executables import NODES
from startracker_ros.options import Options
from startracker_ros.ros import parameters, qos
from startracker_ros.ros.composition import Composition
from startracker_ros.ros.diagnostics import Diagnostics, ERROR
from startracker_ros.ros.ending import Ending
from startracker_ros.ros.last_resort import exit_after
from startracker_ros.ros.shared_memory import remove_left_behind
from std_srvs.srv import Trigger

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    # rclpy before 7.1.4: half a millisecond slower for each message.
    EventsExecutor = SingleThreadedExecutor


_LONG_PASS_S = 0.003

END_S = 5.0
"""Time that DDS is given to end a node, after the node itself has closed what it had open."""


class StartError(RuntimeError):
    """A node that can do nothing as it was started; the text says what to mend."""


class PipelineNode(Node):
    """
    A node whose work is configured by options and reported on /diagnostics.

    Subclasses name their options classes in `option_classes`, their diagnostics task in
    `task`, and build the core in configure(), which runs at start and after each change
    of a parameter.
    """

    option_classes: tuple[type[Options], ...] = ()
    task = ''
    composition: Composition | None = None
    """What joins the nodes of this process, where there are several."""

    ending: Ending
    """Whether this process is to end, for a node whose work has an end."""

    takes_message_info = False
    """Whether callbacks want to know when a message was sent."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._options = parameters.declare(self, self.option_classes)
        self.hardware_id = self.get_namespace().strip('/') or 'star_tracker'
        self.diagnostics = Diagnostics(self, self.task, self.hardware_id)

    def begin(self) -> None:
        """Start the work."""
        self.configure()
        # The last to be asked: what it accepts is set.
        self.add_on_set_parameters_callback(self._take_change)

    def options(self, cls: type[Options]) -> Any:
        """Return the present options of one class."""
        return self._options[cls]

    def configure(self) -> None:
        """Build the core from the options; state is forgotten."""

    def close(self) -> None:
        """Finish what must not be lost, before the node ends."""

    def take(self, message_type: type, topic: str, callback: Callable,
             profile: QoSProfile, *, last: bool = False,
             decode: Callable[[bytes], Any] | None = None) -> None:
        """
        Subscribe; a message that cannot be used is reported by name and counted.

        last: in a process of several nodes, when nothing is left that an attitude waits for.
        decode: what makes a message of serialized bytes, where rclpy takes too long to.
        """
        def guarded(message: Any) -> None:
            self.diagnostics.counts[f'{topic} received'] += 1
            try:
                # In one process a message comes as it was given.
                callback(decode(message) if decode and isinstance(message, bytes) else message)
            except (MessageError, CameraError) as error:
                self.diagnostics.counts[f'{topic} refused'] += 1
                self.diagnostics.report(ERROR, f'{topic}: {error}')

        def subscribe() -> None:
            self.create_subscription(message_type, topic, guarded, profile, raw=decode is not None,
                                     qos_overriding_options=qos.overridable())
        if self.composition is None:
            subscribe()
        else:
            self.composition.take(self.resolve_topic_name(topic), guarded, subscribe, last)

    def afterwards(self, work: Callable[[], None]) -> None:
        """Do work that no attitude waits for: now, or last in a process of several nodes."""
        if self.composition is None:
            work()
        else:
            self.composition.afterwards(work)

    def give(self, message_type: type, topic: str, profile: QoSProfile) -> Any:
        """Return a publisher whose quality of service can be overridden."""
        publisher = self.create_publisher(message_type, topic, profile,
                                          qos_overriding_options=qos.overridable())
        if self.composition is None:
            return publisher
        return self.composition.give(
            publisher, profile.durability is DurabilityPolicy.TRANSIENT_LOCAL)

    def offer_reset(self) -> None:
        """Offer ~/reset: state is forgotten."""
        def reset(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self.configure()
            self.get_logger().info('reset: state forgotten')
            response.success, response.message = True, 'state forgotten'
            return response
        self.create_service(Trigger, '~/reset', reset)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change all or none; what cannot be is refused in words that say what can."""
        try:
            parameters.check(self.option_classes, {p.name: p.value for p in parameter_list})
        except parameters.ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def _take_change(self, changed: list[Parameter]) -> SetParametersResult:
        """Work with changed parameters; those it cannot work with are refused, and undone."""
        changes = {parameter.name: parameter.value for parameter in changed}
        touched = [cls for cls in self.option_classes
                   if any(row.name in changes for row in cls.table())]
        before = self._options
        try:
            self._options = before | {cls: parameters.read(self, cls, changes) for cls in touched}
            if touched:
                self.configure()
                self.get_logger().info('parameters changed: ' + ', '.join(
                    f'{name} = {value}' for name, value in changes.items()))
        except (ValueError, StartError) as error:
            self._options = before
            self.configure()
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def run(node_classes: Sequence[type[PipelineNode]], args: list[str] | None = None) -> int:
    """Run nodes until SIGINT or SIGTERM; return 0, or 2 when one cannot start as asked."""
    # A signal that comes early waits until all is in place.
    ending = PipelineNode.ending = Ending()
    remove_left_behind()
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    nodes: list[PipelineNode] = []
    code = 1
    executor: Any = None
    try:
        # The events executor of rclpy 7.1.6 fails where a callback takes the message info.
        executor = (SingleThreadedExecutor if any(c.takes_message_info for c in node_classes)
                    else EventsExecutor)()
        if len(node_classes) > 1:
            PipelineNode.composition = Composition()
        for node_class in node_classes:
            nodes.append(node_class())  # type: ignore[call-arg]  # each knows its name
        parameters.refuse_unknown(nodes)
        for node in nodes:
            node_class = type(node)
            node.begin()
        if PipelineNode.composition is not None:
            PipelineNode.composition.connect()
        _collect_between_frames(nodes[0])
        for node in nodes:
            executor.add_node(node)
            node.get_logger().info('ready')
        with ending.awaited(wake=partial(executor.create_task, bool)):
            # Not spin(): that of the events executor of rclpy 7.1.6 calls nobody.
            while not ending.asked:
                executor.spin_once(timeout_sec=1.0)
        code = 0
    except (parameters.ParameterError, StartError, CameraError) as error:
        rclpy.logging.get_logger(node_class.__module__.rpartition('.')[2]).fatal(str(error))
        code = 2
    except (Exception, KeyboardInterrupt):
        # What is interrupted may fail in a way of its own.
        if not ending.interrupts:
            raise
        code = 0
    finally:
        for node in nodes:
            node.close()
        if nodes:
            exit_after(END_S, code)
        # The events executor aborts when it goes while callbacks of a node are left in it.
        if executor is not None:
            for node in nodes:
                executor.remove_node(node)
            executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return code


def _collect_between_frames(node: PipelineNode) -> None:
    """
    Collect garbage once a second, and not when the middle of a frame happens to fill it up.

    Long-lived objects leave the collector's view, so that a pass stays short: those of the start
    with what little garbage there is, and after a long pass those that a camera has brought.
    """
    def collect() -> None:
        begin_s = time.perf_counter()
        gc.collect()
        if time.perf_counter() - begin_s > _LONG_PASS_S:
            gc.freeze()
    gc.freeze()
    gc.disable()
    node.create_timer(1.0, collect, clock=Clock(clock_type=ClockType.STEADY_TIME))


def node_class_of(name: str) -> type[PipelineNode]:
    """Return the class of a node by the name of its executable."""
    module = import_module(NODES[name])
    return next(value for value in vars(module).values() if isinstance(value, type)
                and issubclass(value, PipelineNode) and value.__module__ == module.__name__)


def main_of(node_class: type[PipelineNode]) -> Callable[..., None]:
    """Return the main function of a node's executable."""
    def main(args: list[str] | None = None) -> None:
        sys.exit(run([node_class], args))
    return main
