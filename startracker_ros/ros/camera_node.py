"""What the nodes behind a camera share: its camera_info, order and pace of its frames, rates."""

from collections.abc import Callable
import time

from builtin_interfaces.msg import Time
import numpy as np
from sensor_msgs.msg import CameraInfo, Imu
from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.bag.layouts import camera_from_message, MessageError, ns_from_stamp
from startracker_ros.camera.model import Camera, CameraError
from startracker_ros.machine_code import kept_functions, machine_code_folder
from startracker_ros.ros import qos
from startracker_ros.ros.cadence import Cadence
from startracker_ros.ros.diagnostics import WARN
from startracker_ros.ros.messages.gyro import rate_from_imu
from startracker_ros.ros.node import PipelineNode


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
        self._prepared = False
        self._cadence = Cadence()
        self._newest_ns: dict[str, int] = {}
        self.diagnostics.checks.append(self._check_silence)
        self.take(CameraInfo, 'camera_info', self._take_camera, qos.LIST)
        self.diagnostics.report(WARN, 'waiting for camera_info')

    def prepare(self, camera: Camera) -> None:
        """Do once, when the first camera is known, what the first frame must not wait for."""

    def tell_of_compiling(self) -> None:
        """Say why the first frame has to wait, on a machine where nothing is compiled yet."""
        folder = machine_code_folder()
        if not folder:
            self.get_logger().warning(
                'compiling for this machine, for a minute, at each start: no folder to keep it '
                'in can be written, set NUMBA_CACHE_DIR')
        elif not kept_functions(folder):
            self.get_logger().info(
                'compiling for this machine, for a minute, and only once: next time '
                '`python -m startracker_ros.warm_up` does it beforehand')

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
            if not self._prepared:
                self._prepared = True
                self.prepare(camera)
