"""What every node shares: options from parameters, diagnostics, the camera, a clean end."""

from collections.abc import Callable, Sequence
import gc
from importlib import import_module
import signal
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
import cv2
import numpy as np
from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Imu
from startracker_ros.camera import Camera, CameraError
from startracker_ros.catalog.stars import epoch_year_from_stamp
from startracker_ros.executables import NODES
from startracker_ros.options import Options
from startracker_ros.ros import parameters, qos
from startracker_ros.ros.cadence import Cadence
from startracker_ros.ros.composition import Composition
from startracker_ros.ros.diagnostics import Diagnostics, ERROR, WARN
from startracker_ros.ros.last_resort import exit_after
from startracker_ros.ros.messages import (
    camera_from_message, MessageError, ns_from_stamp, rate_from_imu)
from startracker_ros.ros.shared_memory import remove_left_behind
from std_srvs.srv import Trigger

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    # rclpy before 7.1.4: half a millisecond slower for each message.
    EventsExecutor = SingleThreadedExecutor


_END_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
             profile: QoSProfile) -> None:
        """Subscribe; a message that cannot be used is reported by name and counted."""
        def guarded(message: Any) -> None:
            self.diagnostics.counts[f'{topic} received'] += 1
            try:
                callback(message)
            except (MessageError, CameraError) as error:
                self.diagnostics.counts[f'{topic} refused'] += 1
                self.diagnostics.report(ERROR, f'{topic}: {error}')

        def subscribe() -> None:
            self.create_subscription(message_type, topic, guarded, profile,
                                     qos_overriding_options=qos.overridable())
        if self.composition is None:
            subscribe()
        else:
            self.composition.take(self.resolve_topic_name(topic), guarded, subscribe)

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


class CameraNode(PipelineNode):
    """
    A node that needs to know the camera and the date: keeps the newest camera_info.

    A message is in order when its stamp is newer than the last one of its topic. A jump
    back of more than RESTART_NS is a restarted simulation or a looped bag: state is forgotten.
    sensor_frame_id is that of the centroids, for subclasses to set; steady_topic the one that
    brings a message for each frame, whose gaps and silence are told.
    """

    RESTART_NS = 1_000_000_000
    # No star of the catalogue moves by more than 0.2 arcsec in this time, in years.
    EPOCH_TOLERANCE = 0.05

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.camera: Camera | None = None
        self.epoch_year = 0.0
        self.sensor_frame_id = ''
        self.steady_topic = ''
        self._cadence = Cadence()
        self._newest_ns: dict[str, int] = {}
        self.diagnostics.checks.append(self._check_silence)
        self.take(CameraInfo, 'camera_info', self._take_camera, qos.LIST)
        self.diagnostics.report(WARN, 'waiting for camera_info')

    def known_camera(self) -> Camera | None:
        """Return the camera; counts and reports the dropped message where none is known."""
        if self.camera is None:
            self.diagnostics.counts['dropped without camera_info'] += 1
            self.diagnostics.report(WARN, 'no valid camera_info received')
        return self.camera

    def take_rates(self, add: Callable[[int, np.ndarray], bool]) -> None:
        """
        Hand the rates of imu on to add(stamp_ns, rate_rad_s), which is False for a useless one.

        sensor_frame_id, once it is known, is the only frame that rates are taken in.
        """
        def take_imu(message: Imu) -> None:
            rate = rate_from_imu(message)
            if self.sensor_frame_id not in ('', message.header.frame_id):
                raise MessageError(f'frame {message.header.frame_id!r} is not that of the '
                                   f'centroids, {self.sensor_frame_id!r}')
            if (self.in_order('imu', message.header.stamp)
                    and not add(ns_from_stamp(message.header.stamp), rate)):
                raise MessageError(f'angular velocity {rate.tolist()} rad/s cannot be right')
        self.take(Imu, 'imu', take_imu, qos.IMU)

    def in_order(self, topic: str, stamp: Time) -> bool:
        """Return whether a stamp is newer than the last of its topic; counts it if not."""
        stamp_ns = ns_from_stamp(stamp)
        newest_ns = self._newest_ns.get(topic, stamp_ns - 1)
        if newest_ns - stamp_ns > self.RESTART_NS:
            self.diagnostics.note(
                f'{topic}: time went back by {(newest_ns - stamp_ns) / 1e9:.1f} s, '
                'state forgotten')
            self._newest_ns.clear()
            self._cadence = Cadence()
            self.configure()
        elif stamp_ns <= newest_ns:
            self.diagnostics.counts[f'{topic} out of order'] += 1
            self.diagnostics.report(WARN, f'{topic}: frame out of order dropped')
            return False
        self._newest_ns[topic] = stamp_ns
        if topic == self.steady_topic:
            self._follow_cadence(stamp_ns)
        return True

    def _follow_cadence(self, stamp_ns: int) -> None:
        topic = self.steady_topic
        missing, ahead_s = self._cadence.arrived(stamp_ns, time.monotonic())
        if missing:
            self.diagnostics.counts[f'{topic} missing'] += missing
            self.diagnostics.note(f'{topic}: frames are missing')
        elif ahead_s:
            self.diagnostics.note(f'{topic}: time went ahead by {ahead_s:.1f} s')

    def _check_silence(self) -> None:
        if self._cadence.is_silent(time.monotonic()):
            self.diagnostics.report(WARN, f'{self.steady_topic}: nothing comes in')

    def _take_camera(self, message: CameraInfo) -> None:
        try:
            camera = camera_from_message(message)
        except CameraError:
            # The lens is not what it was: nothing goes out until a sound camera_info comes.
            self.camera = None
            raise
        epoch_year = epoch_year_from_stamp(ns_from_stamp(message.header.stamp))
        if self.camera is not None and camera != self.camera:
            self.diagnostics.note(
                f'another camera: {camera.width} x {camera.height} px, '
                f'{np.degrees(camera.fov_x_rad):.2f} deg wide')
        if camera != self.camera or abs(epoch_year - self.epoch_year) > self.EPOCH_TOLERANCE:
            self.camera, self.epoch_year = camera, epoch_year
            self.get_logger().info(
                f'camera {camera.width} x {camera.height} px, '
                f'{np.degrees(camera.fov_x_rad):.2f} deg wide, epoch J{epoch_year:.2f}')
            self.configure()


def run(node_classes: Sequence[type[PipelineNode]], args: list[str] | None = None) -> int:
    """Run nodes until SIGINT or SIGTERM; return 0, or 2 when one cannot start as asked."""
    # The nodes of a pipeline share the cores; OpenCV's threads would only wait for each other.
    cv2.setNumThreads(1)
    # A signal that comes early waits until all is in place: rclpy leaves half-made objects
    # behind when its context ends under their construction.
    signal.pthread_sigmask(signal.SIG_BLOCK, _END_SIGNALS)
    remove_left_behind()
    rclpy.init(args=args)
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
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _END_SIGNALS)
        # Not spin(): that of the events executor of rclpy 7.1.6 calls nobody.
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
        code = 0
    except (ExternalShutdownException, KeyboardInterrupt):
        code = 0
    except RCLError:
        # A signal ends the context at once; a callback under way then fails to publish.
        if rclpy.ok():
            raise
        code = 0
    except (parameters.ParameterError, StartError, CameraError) as error:
        rclpy.logging.get_logger(node_class.__module__.rpartition('.')[2]).fatal(str(error))
        code = 2
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

    Long-lived objects leave the collector's view, so that a pass stays short.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    node.create_timer(1.0, gc.collect, clock=Clock(clock_type=ClockType.STEADY_TIME))


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
