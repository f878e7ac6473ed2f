# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What every node shares: options from parameters, diagnostics, clean shutdown."""

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
import gc
from importlib import import_module
import inspect
import os
from pathlib import Path
import sys
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from startracker_ros.core.camera.model import CameraError
from startracker_ros.core.options import Options
from startracker_ros.io.bags.layouts import MessageError
from startracker_ros.ros import parameters, qos
from startracker_ros.ros.composition import Composition, IntraProcessPublisher
from startracker_ros.ros.diagnostics import Diagnostics, ERROR
from startracker_ros.ros.executables import NODES, WRONG_USE
from startracker_ros.ros.incompatible_qos import IncompatiblePublishers
from startracker_ros.ros.managed import LifecycleOptions, ManagedNode, StartError
from startracker_ros.ros.memory import choose_segment, remove_left_behind
from startracker_ros.ros.messages.rclpy_internals import take_all
from startracker_ros.ros.messages.serialized import deserialized, is_read_here
from startracker_ros.ros.shutdown import exit_after, Shutdown
from std_msgs.msg import Header
from std_srvs.srv import Trigger

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    # rclpy before 7.1.4: half a millisecond slower for each message.
    EventsExecutor = SingleThreadedExecutor


_LONG_COLLECTION_S = 0.003

EXIT_TIMEOUT_S = 5.0
"""Time for DDS to remove a node that has closed its files."""


class PipelineNode(ManagedNode):
    """
    A managed node with options from parameters and a status on /diagnostics.

    Subclasses name their options classes in `option_classes`, their diagnostics task in
    `task`, and build the core in rebuild(), which runs at configuration and after each change
    of a parameter. Until a node is active it drops what it receives, as if that had been lost in
    transport.
    """

    option_classes: tuple[type[Options], ...] = ()
    task = ''
    composition: Composition | None = None
    """The other nodes of this process, None for a node alone."""

    shutdown: Shutdown
    """For a node that ends by itself when its work is done."""

    sends_images = False
    """Whether it publishes star images."""

    def __init_subclass__(cls) -> None:
        """Add the options of every node to those that a class names."""
        if 'option_classes' in vars(cls):
            cls.option_classes = (*cls.option_classes, LifecycleOptions)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._prepared = False
        self._options = parameters.declare(self, self.option_classes)
        self.hardware_id = hardware_id_of(self.get_namespace())
        self.diagnostics = Diagnostics(self, self.task, self.hardware_id)
        self._incompatible_publishers = IncompatiblePublishers(self, self.diagnostics)
        self._take_first: list[Callable[[], None]] = []
        self._subscribed: dict[str, Subscription] = {}

    def begin(self) -> None:
        """Configure and activate unless a manager does, and accept changes of parameters."""
        if self.options(LifecycleOptions).autostart:
            self.autostart()
        else:
            self.on_state(self.state_label)
        # Last: rclpy sets the parameters that the last callback has accepted.
        self.add_on_set_parameters_callback(self._on_change)

    def configure(self) -> None:
        self.rebuild()
        if not self._prepared:
            self._prepared = True
            self.get_ready()
            self.get_logger().info('ready')

    def on_state(self, label: str) -> None:
        if label == 'active':
            self.diagnostics.release()
        else:
            self.diagnostics.hold(label)

    def get_ready(self) -> None:
        """Get ready for messages, once, after the first rebuild()."""

    @property
    def is_busy(self) -> bool:
        """Whether a thread of the node builds or searches."""
        return False

    def options(self, cls: type[Options]) -> Any:
        """Return the current options of one class."""
        return self._options[cls]

    def rebuild(self) -> None:
        """Build the core from the options; state is lost."""

    def set_live_options(self) -> None:
        """Use options that have changed, of those that are live, without loss of state."""

    def close(self) -> None:
        """Close files, before the node is destroyed."""

    def subscribe(self, message_type: type, topic: str, callback: Callable,
                  profile: QoSProfile, *, first: bool = False, last: bool = False,
                  while_inactive: bool = False) -> None:
        """
        Subscribe to a topic; messages that the callback rejects are reported and counted.

        first: all of its messages that have come are processed before one of another topic.
        last: among several nodes of a process, after all that the attitude depends on.
        while_inactive: also in the state inactive.
        """
        def guarded(message: Any) -> None:
            for take in () if first else self._take_first:
                take()
            if not (self.active or while_inactive and self.configured):
                self.diagnostics.counts[f'{topic} while not active'] += 1
                return
            self.diagnostics.counts[f'{topic} received'] += 1
            # What is latched holds now.
            if while_inactive or profile.durability is DurabilityPolicy.TRANSIENT_LOCAL:
                process(message)
            else:
                self.accept(topic, partial(process, message), profile.depth)

        def process(message: Any) -> None:
            # Within a process messages come as they were published, serialized or not.
            self.guard(topic, lambda: callback(
                deserialized(message, message_type) if isinstance(message, bytes) else message))

        def subscribe_dds() -> None:
            with qos.named_errors('subscription', topic):
                # A copy: rclpy writes the overrides into the profile that it receives.
                subscription = self.create_subscription(
                    message_type, topic, guarded, copy(profile),
                    raw=is_read_here(message_type),
                    qos_overriding_options=qos.overridable(),
                    event_callbacks=self._incompatible_publishers.callbacks(topic))
            self._subscribed[topic] = subscription
            if first:
                self._take_first.append(partial(take_all, subscription, guarded))
        if self.composition is None:
            subscribe_dds()
        else:
            self.composition.subscribe(
                self.resolve_topic_name(topic), guarded, subscribe_dds, last)

    def has_publisher(self, topic: str) -> bool:
        """Return whether a publisher of a subscribed topic is matched, or is in this process."""
        return topic not in self._subscribed or self._subscribed[topic].get_publisher_count() > 0

    def guard(self, topic: str, work: Callable[[], None]) -> None:
        """Do work with a message; one that it rejects is reported and counted."""
        try:
            work()
        except (MessageError, CameraError) as error:
            self.diagnostics.counts[f'{topic} rejected'] += 1
            self.diagnostics.report(ERROR, f'{topic}: {error}')

    def accept(self, topic: str, process: Callable[[], None], depth: int) -> None:
        """Process a message now, or keep it: of each topic no more than depth wait."""
        process()

    def defer(self, work: Callable[[], None]) -> None:
        """Do work that the attitude does not depend on: now, or last among several nodes."""
        if self.composition is None:
            work()
        else:
            self.composition.defer(work)

    def advertise(self, message_type: type, topic: str, profile: QoSProfile) -> Any:
        """Return a publisher whose quality of service can be overridden."""
        with qos.named_errors('publisher', topic):
            publisher = self.create_publisher(message_type, topic, copy(profile),
                                              qos_overriding_options=qos.overridable())
        if self.composition is None:
            return publisher
        return self.composition.advertise(
            publisher, profile.durability is DurabilityPolicy.TRANSIENT_LOCAL)

    def advertise_trigger(self, name: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Advertise the service ~/name (std_srvs/Trigger): act() returns success and message."""
        def on_request(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = act()
            return response
        self.create_service(Trigger, f'~/{name}', on_request)

    def advertise_reset(self) -> None:
        """Advertise the service ~/reset."""
        def reset() -> tuple[bool, str]:
            if not self.configured:
                return False, 'not configured'
            self.rebuild()
            self.get_logger().info('reset: state forgotten')
            return True, 'state forgotten'
        self.advertise_trigger('reset', reset)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """
        Change all parameters or none; a rejection says what is allowed.

        Setting a parameter to its current value has no effect, also where it is read only.
        """
        changed = [p for p in parameter_list if not parameters.is_current(self, p)]
        try:
            for name in (p.name for p in changed if not self.has_parameter(p.name)):
                # The text of rclpy does not name it.
                raise parameters.ParameterError(parameters.unknown(name, [self]))
            parameters.check(self.option_classes, {p.name: p.value for p in changed})
        except parameters.ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(changed)

    def _on_change(self, changed: list[Parameter]) -> SetParametersResult:
        """Rebuild with changed parameters; restore the old ones if that fails."""
        changes = {parameter.name: parameter.value for parameter in changed}
        touched = [cls for cls in self.option_classes
                   if any(row.name in changes for row in cls.table())]
        before = self._options
        try:
            self._options = before | {cls: parameters.read(self, cls, changes) for cls in touched}
            if touched and self._are_live(changes):
                self.set_live_options()
            elif touched:
                self.rebuild_configured()
            if touched:
                self.get_logger().info('parameters changed: ' + ', '.join(
                    f'{name} = {value}' for name, value in changes.items()))
        except (ValueError, StartError) as error:
            self._options = before
            self.rebuild_configured()
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _are_live(self, changes: dict[str, object]) -> bool:
        return self.configured and all(
            row.live for cls in self.option_classes for row in cls.table() if row.name in changes)

    def rebuild_configured(self) -> None:
        """Rebuild a configured node; configure() builds another."""
        if self.configured:
            self.rebuild()


def hardware_id_of(namespace: str) -> str:
    """Return the hardware id of the diagnostics of the nodes in a namespace."""
    return namespace.strip('/') or 'star_tracker'


def publish_if_subscribed(publisher: Any, message: Callable[[], Any]) -> None:
    """Publish what message() returns; without a subscription it is not made."""
    if publisher.get_subscription_count():
        publisher.publish(message())


def publish_value(publisher: Any, header: Header, value: Any, serialize: Callable[[], bytes]
                  ) -> None:
    """Publish what serialize() returns; nodes of this process receive the value itself."""
    if isinstance(publisher, IntraProcessPublisher):
        publisher.publish_value(header, value, serialize)
    else:
        publisher.publish(serialize())


def run(node_classes: Sequence[type[PipelineNode]], args: list[str] | None = None) -> int:
    """
    Run nodes until SIGINT or SIGTERM, or until one requests the end with an exit code.

    Returns 0, that code, or WRONG_USE if one cannot start as requested.
    """
    # First, so that an early signal is not lost.
    shutdown = PipelineNode.shutdown = Shutdown()
    remove_left_behind()
    choose_segment(any(node_class.sends_images for node_class in node_classes))
    if not _initialize(args, node_classes[0]):
        return WRONG_USE
    nodes: list[PipelineNode] = []
    code = 1
    executor: Any = None
    try:
        executor = EventsExecutor()
        if len(node_classes) > 1:
            PipelineNode.composition = Composition()
        for node_class in node_classes:
            nodes.append(node_class())  # type: ignore[call-arg]  # each sets its name
        parameters.reject_unknown(nodes, sys.argv[1:] if args is None else args)
        if PipelineNode.composition is not None:
            PipelineNode.composition.connect()
        for node in nodes:
            executor.add_node(node)
        for node in nodes:
            node_class = type(node)
            node.begin()
        _collect_between_frames(nodes[0])
        with shutdown.while_spinning(wake=partial(executor.create_task, bool)):
            # spin() of the events executor of rclpy 7.1.6 runs no callback.
            while not shutdown.requested:
                executor.spin_once(timeout_sec=1.0)
        code = shutdown.code
    except (parameters.ParameterError, StartError, CameraError) as error:
        _log_fatal(node_class, error)
        code = WRONG_USE
    except (Exception, KeyboardInterrupt):
        # An interrupted callback may raise anything.
        if not shutdown.interrupts:
            raise
        code = shutdown.code
    finally:
        for node in nodes:
            node.close()
        exit_after(EXIT_TIMEOUT_S, code)
        # The events executor aborts if it is destroyed with callbacks of a node in it.
        if executor is not None:
            for node in nodes:
                executor.remove_node(node)
            executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        if any(node.is_busy for node in nodes) and sys.exc_info()[0] is None:
            # The end of the interpreter could free what a thread is using.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    return code


def _initialize(args: list[str] | None, node_class: type[PipelineNode]) -> bool:
    """Initialize rclpy; False for wrong arguments or a parameter file that cannot be read."""
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        _log_fatal(node_class, error)
        return False
    return True


def _log_fatal(node_class: type[PipelineNode], error: Exception) -> None:
    """Log why a node cannot start."""
    # Not by the module, which is __main__ under `python -m`.
    log_fatal(Path(inspect.getfile(node_class)).stem, error)


def log_fatal(name: str, error: Exception) -> None:
    """Log why an executable cannot start, without the lines of the C sources of rcl."""
    rclpy.logging.get_logger(name).fatal(str(error).partition(', at /')[0])


def _collect_between_frames(node: PipelineNode) -> None:
    """
    Collect garbage once a second instead of in the middle of a frame.

    Long-lived objects are frozen so that a collection stays short: those of the start, and after
    a long collection those that were made for a camera.
    """
    def collect() -> None:
        begin_s = time.perf_counter()
        gc.collect()
        if time.perf_counter() - begin_s > _LONG_COLLECTION_S:
            gc.freeze()
    gc.freeze()
    gc.disable()
    node.create_steady_timer(1.0, collect)


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
