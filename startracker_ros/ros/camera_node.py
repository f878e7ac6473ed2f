# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the nodes behind a camera share: camera_info, order of the frames, gyro rates."""

from collections import Counter, deque
from collections.abc import Callable
from threading import Lock, Thread
import time
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from sensor_msgs.msg import CameraInfo, Imu
from startracker_ros.core.astro.epoch import (
    catalogue_epoch, CatalogueEpoch, NOT_STAMPED, RESTART_NS)
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.io.bags.layouts import (
    camera_from_message, MessageError, ns_from_stamp, SENSOR_FRAME_ID)
from startracker_ros.io.bags.telemetry import rate_from_imu
from startracker_ros.ros import qos
from startracker_ros.ros.cadence import Cadence
from startracker_ros.ros.diagnostics import WARN
from startracker_ros.ros.memory import return_free_memory
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.one_call import OneCall
from startracker_ros.ros.topic_status import TopicStatus

"""Counts camera_info of the time in which the code is loaded."""

CAMERA = 'camera'
"""The value of the diagnostics that names the camera that a node is set up for."""

_DROPPED = 'dropped without camera_info'
_LINK_PERIOD_S = 0.02
LINK_LIMIT_S = 10.0
"""Time to find the stage before: on a busy machine discovery takes seconds, or it does not run."""

# One after the other: the nodes of a process share catalogues, which are built once then.
_BUILDING = Lock()


def camera_text(camera: Camera) -> str:
    """Return size and field of a camera, as the log and the diagnostics name it."""
    return f'{camera.width} x {camera.height} px, {np.degrees(camera.seen_x_rad):.2f} deg wide'


def is_building() -> bool:
    """Return whether a thread of this process builds something for a camera."""
    return _BUILDING.locked()


class CameraSetup:
    """
    Calls build() in a thread; it must not use anything that the node changes meanwhile.

    One that is superseded before its turn is not built: a camera that changes with each message
    costs one thread at a time.
    """

    def __init__(self, camera: Camera, build: Callable[[], Any]) -> None:
        self.camera = camera
        self._build = build
        self._built: Any = None
        self._error: BaseException | None = None
        self.superseded = False
        self._thread = Thread(target=self._run, name='camera set-up', daemon=True)
        self._thread.start()

    @property
    def is_done(self) -> bool:
        """Whether build() has ended."""
        return not self._thread.is_alive()

    def built(self) -> Any:
        """Return what build() has returned, or raise what it has raised."""
        if self._error is not None:
            raise self._error
        return self._built

    def _run(self) -> None:
        with _BUILDING:
            try:
                if not self.superseded:
                    self._built = self._build()
            except BaseException as error:
                self._error = error


class WaitingMessages:
    """Messages in the order of their arrival, of each topic a bounded number of the newest."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[str, Callable[[], None]]] = deque()
        self._counts: Counter[str] = Counter()

    def add(self, topic: str, process: Callable[[], None], depth: int) -> bool:
        """Keep the processing of a message; return whether the oldest was dropped for it."""
        self._waiting.append((topic, process))
        self._counts[topic] += 1
        if self._counts[topic] <= depth:
            return False
        del self._waiting[next(index for index, entry in enumerate(self._waiting)
                               if entry[0] == topic)]
        self._counts[topic] -= 1
        return True

    def process(self) -> None:
        """Process all."""
        while self._waiting:
            topic, process = self._waiting.popleft()
            self._counts[topic] -= 1
            process()

    def clear(self) -> list[str]:
        """Drop all; return their topics."""
        topics = [topic for topic, _ in self._waiting]
        self._waiting.clear()
        self._counts.clear()
        return topics


class CameraNode(PipelineNode):
    """
    A node whose core depends on the camera and the epoch, both from camera_info.

    A message is in order when its stamp is newer than the last one of its topic. A jump
    back of more than RESTART_NS is a restarted simulation or a looped bag: state is lost, once
    for all topics. Messages from before the restart may still be in the queues of other topics.
    What depends on the camera is built in a thread, so that diagnostics continue. Messages wait
    for it, and for the first camera_info, in the order of their arrival: of each topic as many as
    its queue holds.

    Subclasses set frame_topic, which has one message for each frame: its gaps and silence are
    reported, and follow_frame() takes the optical frame of the sensor from it. They override
    restart(), builder() and use() instead of rebuild().
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.camera: Camera | None = None
        self.epoch = CatalogueEpoch(0.0)
        self.sensor_frame_id = ''
        self.frame_topic = ''
        self._setup: CameraSetup | None = None
        self._waiting = WaitingMessages()
        self._waits_for_camera = True
        self._cadence = Cadence()
        self._newest_ns: dict[str, int] = {}
        self._restarted = False
        self._topic_status = TopicStatus(self.get_clock())
        self.diagnostics.checks.append(self._check_silence)

    def begin(self) -> None:
        if self.frame_topic:
            self.diagnostics.tasks[f'{self.frame_topic} topic status'] = self._topic_status.run
        super().begin()

    def activate(self) -> None:
        # The time without frames is not a gap of the source.
        self._cadence = Cadence()
        self._topic_status.restart()

    def deactivate(self) -> None:
        for topic in self._waiting.clear():
            self.diagnostics.counts[f'{topic} while not active'] += 1

    def cleanup(self) -> None:
        self.camera = None
        self._end_set_up()
        self._waits_for_camera = True
        self.sensor_frame_id = ''
        self._newest_ns.clear()
        self._restarted = False

    @property
    def is_busy(self) -> bool:
        return is_building()

    @property
    def one_call(self) -> OneCall | None:
        """What the stages of a process share, None for a node alone."""
        return None if self.composition is None else self.composition.one_call

    @property
    def is_set_up(self) -> bool:
        """Whether messages are processed as they come, with a camera."""
        return self.camera is not None and self._setup is None

    def restart(self) -> None:
        """Forget the state and read the options, before anything is built for the camera."""

    def builder(self, camera: Camera, epoch_year: float) -> Callable[[], Any] | None:
        """
        Return the function that builds what depends on the camera, None for a node without.

        It runs in a thread: it must not use anything that the node changes.
        """

    def use(self, built: Any) -> None:
        """Use what the builder has built; the camera is set."""

    def rebuild(self) -> None:
        if self._setup is not None:
            # It may have the options of before.
            self._set_up(self._setup.camera, self.epoch)
            return
        self.restart()
        if self.camera is not None:
            build = self.builder(self.camera, self.epoch.year)
            self.use(None if build is None else build())

    def get_ready(self) -> None:
        """Subscribe to the source, once the publisher of the frames is matched."""
        self._ready_s = time.monotonic()
        self._link_timer = self.create_steady_timer(_LINK_PERIOD_S, self._link)
        self._link()

    def _link(self) -> None:
        """
        Subscribe to camera_info if the frames can come, or have no publisher for LINK_LIMIT_S.

        A source that waits for its users would else begin while one stage has not found the other.
        """
        if (not self.has_publisher(self.frame_topic)
                and time.monotonic() - self._ready_s < LINK_LIMIT_S):
            self.diagnostics.report(
                WARN, f'waiting for a publisher of {self.frame_topic}', expected=True)
            return
        self._link_timer.cancel()
        self.report_camera()
        self.subscribe_camera_info()

    def report_camera(self) -> None:
        """Report that the camera is not known yet, if so."""
        if self.camera is None:
            self.diagnostics.report(WARN, 'waiting for camera_info', expected=True)

    def subscribe_camera_info(self) -> None:
        """Subscribe to camera_info: sources take a subscriber for a stage that is ready."""
        self.subscribe(CameraInfo, 'camera_info', self._on_camera_info, qos.LIST,
                       while_inactive=True)

    def camera_or_drop(self) -> Camera | None:
        """Return the camera; without one, count and report that the message is dropped."""
        if self.camera is None:
            self._count_dropped(1)
        return self.camera

    def accept(self, topic: str, process: Callable[[], None], depth: int) -> None:
        if self._setup is None and not self._waits_for_camera:
            process()
            return
        self._count_dropped(self._waiting.add(topic, process, depth))

    def _count_dropped(self, messages: int) -> None:
        if messages:
            self.diagnostics.counts[_DROPPED] += messages
            self.diagnostics.report(WARN, 'no valid camera_info received' if self._setup is None
                                    else 'messages dropped while the set-up for the camera runs')

    def subscribe_rates(self, add: Callable[[int, np.ndarray], bool]) -> None:
        """
        Subscribe to imu for add(stamp_ns, rate_rad_s), which returns False for an unusable rate.

        Rates in another frame than sensor_frame_id are rejected once that is known; an empty
        frame_id is SENSOR_FRAME_ID, as of images.
        """
        def on_imu(message: Imu) -> None:
            rate = rate_from_imu(message)
            if self.sensor_frame_id not in ('', message.header.frame_id or SENSOR_FRAME_ID):
                raise MessageError(f'frame {message.header.frame_id!r} is not that of the '
                                   f'centroids, {self.sensor_frame_id!r}')
            if (self.in_order('imu', message.header.stamp)
                    and not add(ns_from_stamp(message.header.stamp), rate)):
                raise MessageError(f'angular velocity {rate.tolist()} rad/s cannot be right')
        self.subscribe(Imu, 'imu', on_imu, qos.IMU, first=True)

    def in_order(self, topic: str, stamp: Time) -> bool:
        """
        Return whether a stamp is newer than the last of its topic; counts it if not.

        MessageError for the stamp of a driver that does not stamp.
        """
        stamp_ns = ns_from_stamp(stamp)
        if not stamp_ns:
            raise MessageError(NOT_STAMPED)
        newest_ns = self._newest_ns.get(topic)
        if newest_ns is None:
            if self._restarted and stamp_ns - max(self._newest_ns.values()) > RESTART_NS:
                self.diagnostics.counts[f'{topic} from before the restart'] += 1
                return False
        elif newest_ns - stamp_ns > RESTART_NS:
            self.diagnostics.report_event(
                f'{topic}: time went back by {(newest_ns - stamp_ns) / 1e9:.1f} s, '
                'state forgotten')
            self._newest_ns.clear()
            self._restarted = True
            self._cadence = Cadence()
            self.rebuild()
        elif stamp_ns <= newest_ns:
            self.diagnostics.counts[f'{topic} out of order'] += 1
            self.diagnostics.report(WARN, f'{topic}: frame out of order dropped')
            return False
        self._newest_ns[topic] = stamp_ns
        if topic == self.frame_topic:
            self._follow_cadence(stamp_ns)
        return True

    def follow_frame(self, frame_id: str) -> str:
        """Return the frame of the sensor, that of a frame; an empty or another one is reported."""
        if not frame_id:
            self.diagnostics.report_event(
                f'{self.frame_topic}: frame_id is empty, {SENSOR_FRAME_ID} is used: set it in the '
                'camera driver')
        frame_id = frame_id or SENSOR_FRAME_ID
        if self.sensor_frame_id not in ('', frame_id):
            self.diagnostics.report_event(
                f'{self.frame_topic}: frame_id changes from {self.sensor_frame_id!r} to '
                f'{frame_id!r}: two cameras on one topic?')
        self.sensor_frame_id = frame_id
        return frame_id

    def _follow_cadence(self, stamp_ns: int) -> None:
        topic = self.frame_topic
        missing, ahead_s = self._cadence.arrived(stamp_ns, time.monotonic())
        self._topic_status.arrived(stamp_ns, missing)
        if missing:
            self.diagnostics.counts[f'{topic} missing'] += missing
            self.diagnostics.report_event(f'{topic}: frames are missing{self.why_missing()}')
        elif ahead_s:
            self.diagnostics.report_event(f'{topic}: time went ahead by {ahead_s:.1f} s')

    @property
    def interval_s(self) -> float:
        """The usual interval between the arrivals of frames, 0 while it is not known."""
        return self._cadence.interval_s or 0.0

    def why_missing(self) -> str:
        """Return why frames of the source may be missing, and what to do, where it is known."""
        return ''

    def _check_silence(self) -> None:
        if self._cadence.is_silent(time.monotonic()):
            self.diagnostics.report(WARN, f'{self.frame_topic}: nothing comes in')

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            camera = camera_from_message(message)
        except CameraError:
            # The old camera is not valid any more either, nor are frames that wait for one.
            self.camera = None
            self._end_set_up()
            self._waits_for_camera = False
            raise
        epoch = catalogue_epoch(ns_from_stamp(message.header.stamp),
                                self.get_clock().now().nanoseconds)
        newest = self if self._setup is None else self._setup
        same = camera.is_same(newest.camera)
        if newest.camera is not None and not same:
            moved_px = camera.difference_px(newest.camera)
            self.diagnostics.report_event(
                f'another camera: {camera_text(camera)}'
                + ('' if np.isinf(moved_px) else f', stars up to {moved_px:.2g} px apart'))
            # Frames of the camera before.
            self._end_set_up()
        if not same or not epoch.is_near(self.epoch):
            self.get_logger().info(f'camera {camera_text(camera)}, {epoch}')
            self._set_up(camera, epoch)

    def _set_up(self, camera: Camera, epoch: CatalogueEpoch) -> None:
        """Build what depends on the camera; until then messages wait."""
        self.epoch = epoch
        self.diagnostics.values.pop(CAMERA, None)
        self.restart()
        build = self.builder(camera, epoch.year)
        if build is None:
            self.camera = camera
            self._process_waiting()
            return
        if self._setup is None:
            self._setup_timer = self.create_steady_timer(0.01, self._check_set_up)
        else:
            self._setup.superseded = True
        self._setup = CameraSetup(camera, build)

    def _check_set_up(self) -> None:
        if (setup := self._setup) is not None and setup.is_done:
            self._setup = None
            self.destroy_timer(self._setup_timer)
            self.guard('camera_info', lambda: self._use_camera(setup))
            self._process_waiting()

    def _use_camera(self, setup: CameraSetup) -> None:
        # With a CameraError there is none: what was built for the old one does not fit.
        self.camera = None
        built = setup.built()
        self.camera = setup.camera
        self.use(built)
        # Live options that have changed meanwhile.
        self.set_live_options()
        return_free_memory()

    def _process_waiting(self) -> None:
        if self.camera is not None:
            self.diagnostics.values[CAMERA] = camera_text(self.camera)
        self._waits_for_camera = False
        self._waiting.process()

    def _end_set_up(self) -> None:
        """Drop what waits for a camera, and what is being built for it."""
        self.diagnostics.values.pop(CAMERA, None)
        self._count_dropped(len(self._waiting.clear()))
        if self._setup is not None:
            self._setup.superseded = True
            self._setup = None
            self.destroy_timer(self._setup_timer)
