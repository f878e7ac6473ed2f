"""A star tracker of real processes, the sky that it looks at, and a judge of what it says."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, QuaternionStamped
import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.figures.correctness import is_wrong
from startracker_ros.harness.rig import Rig
from startracker_ros.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import attitude_from_pose, quaternion_from_message
from startracker_ros.ros.messages.camera_info import camera_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.sky.detector import DetectorOptions
from startracker_ros.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(512, 512, 12.0)
FRAME_RATE_HZ = 10.0
STEP_NS = round(1e9 / FRAME_RATE_HZ)
RATE_DEG_S = (0.05, 0.1, 0.02)
_SENSOR, _INERTIAL = 'star_tracker_optical_frame', 'icrf'
_STREAK = 5
"""Frames in a row that must have an attitude to count as recovered."""
_NEAR = 10
"""Frames within which a truth that was not heard is made up; restarts are further apart."""


@dataclass(frozen=True)
class Frame:
    """What the camera sends: the camera itself, image (H, W), stamp, true attitude (4,)."""

    camera: Camera
    image: np.ndarray
    stamp_ns: int
    truth: np.ndarray


@dataclass(frozen=True)
class Attitude:
    """A published attitude (4,) with its covariance (3, 3) about sensor axes, when it came."""

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray
    received_s: float


@dataclass(frozen=True)
class Said:
    """One diagnostic."""

    received_s: float
    node: str
    level: bytes
    message: str


class Flight(Rig):
    """
    Publishes images at a steady pace, unless a sky_simulator does, and keeps what comes back.

    disturb turns a frame into those that are sent in its place; clock_ns is added to the
    stamps. Times are those of the steady clock in s.
    """

    def __init__(self, folder: Path, *, seed: int, environment: dict[str, str] | None = None
                 ) -> None:
        super().__init__(folder, environment)
        self.seed = seed
        self.sent_s: dict[int, float] = {}
        self._truth: dict[int, np.ndarray] = {}
        self.attitudes: list[Attitude] = []
        self._alone: dict[int, np.ndarray] = {}
        self.said: list[Said] = []
        self.listen(DiagnosticArray, '/diagnostics', self._take_diagnostics)
        self.listen(PoseWithCovarianceStamped, 'attitude_cov', self._take_attitude_cov)
        self.listen(QuaternionStamped, 'attitude', self._take_attitude)
        self.listen(QuaternionStamped, 'truth/attitude', self._take_truth)
        self._camera_info = self.node.create_publisher(CameraInfo, 'camera_info', qos.LIST)
        self._image = self.node.create_publisher(Image, 'image_raw', qos.IMAGE)
        self.started_s: dict[str, float] = {}
        self.sends_images = True
        self.disturb: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.clock_ns = 0
        self._begin_ns = time.time_ns()
        self._index = 0
        self._next_s = time.monotonic()
        self.see_with(CAMERA)

    def see_with(self, camera: Camera) -> None:
        """Take the images with a camera from now on."""
        self._camera = camera
        motion = motion_from_options(MotionOptions(
            motion='constant_rate', rate_deg_s=RATE_DEG_S))
        self._simulator = SkySimulator(
            camera, motion, load_catalog(), epoch_year_from_stamp(self._begin_ns), seed=self.seed)

    @property
    def stamp_ns(self) -> int:
        """Return the stamp of the newest frame."""
        return self._begin_ns + self._index * STEP_NS + self.clock_ns

    @property
    def bag(self) -> Path:
        """Return the newest bag."""
        return max(self.folder.glob('bag_[0-9]*'), key=lambda path: path.stat().st_mtime_ns)

    # --- processes ---

    def start(self, node: str) -> None:
        """Start a node, or start it again, with the parameters that suit the flight."""
        parameters: dict[str, object] = {}
        if node == 'sky_simulator':
            parameters = {'width': CAMERA.width, 'height': CAMERA.height, 'fov_deg': 12.0,
                          'motion': 'constant_rate', 'rate_deg_s': list(RATE_DEG_S),
                          'frame_rate_hz': FRAME_RATE_HZ, 'seed': self.seed}
        elif node == 'bag_recorder':
            number = len(list(self.folder.glob('bag_[0-9]*')))
            parameters = {'folder': str(self.folder / f'bag_{number}'),
                          'exclude': ['/image_raw', '*/image_annotated']}
        self.started_s[node] = time.monotonic()
        self.start_node(node, parameters)

    # --- time goes on ---

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Go on for some seconds, or until something holds; return whether it did."""
        deadline_s = time.monotonic() + seconds
        while not until():
            now_s = time.monotonic()
            if now_s >= deadline_s:
                return False
            if now_s >= self._next_s:
                self._next_s = max(self._next_s + STEP_NS * 1e-9, now_s - 0.5)
                if self.sends_images:
                    self._send()
            wait_s = min(self._next_s, deadline_s) - time.monotonic()
            self.spin(max(0.0, min(wait_s, 0.05)))
        return True

    def _send(self) -> None:
        self._index += 1
        made = self._simulator.frame(self._index * STEP_NS * 1e-9)
        for frame in self.disturb(Frame(
                self._camera, made.image, self.stamp_ns, made.state.q_icrf_from_sensor)):
            header = make_header(frame.stamp_ns, _SENSOR)
            self._truth[frame.stamp_ns] = frame.truth
            self.sent_s[frame.stamp_ns] = time.monotonic()
            self._camera_info.publish(camera_to_message(frame.camera, header))
            self._image.publish(image_to_message(frame.image, header))

    def _take_truth(self, message: QuaternionStamped) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._truth[stamp_ns] = quaternion_from_message(message)
        self.sent_s[stamp_ns] = time.monotonic()

    def _take_attitude(self, message: QuaternionStamped) -> None:
        self._alone[ns_from_stamp(message.header.stamp)] = (
            quaternion_from_message(message))

    def _take_attitude_cov(self, message: PoseWithCovarianceStamped) -> None:
        quaternion, covariance = attitude_from_pose(message, _INERTIAL)
        matrix = matrix_from_quaternion(quaternion)
        self.attitudes.append(Attitude(
            ns_from_stamp(message.header.stamp), quaternion,
            matrix.T @ covariance @ matrix, time.monotonic()))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.said.append(Said(time.monotonic(), status.name.partition(':')[0],
                                  status.level, status.message))

    # --- what was seen ---

    def recovered_s(self, since_s: float) -> float | None:
        """
        Return when the first of some frames in a row had its attitude, None for not yet.

        Frames sent since then count.
        """
        received = {attitude.stamp_ns: attitude.received_s for attitude in self.attitudes
                    if attitude.received_s >= since_s}
        row: list[int] = []
        for stamp_ns, sent_s in self.sent_s.items():
            if sent_s >= since_s:
                row = [*row, stamp_ns] if stamp_ns in received else []
                if len(row) == _STREAK:
                    return received[row[0]]
        return None

    def wait_recovered(self, since_s: float, patience_s: float) -> float | None:
        """Fly until recovered_s() is known and return it, None if that takes too long."""
        self.fly(patience_s, lambda: self.recovered_s(since_s) is not None)
        return self.recovered_s(since_s)

    def heard(self, node: str, words: str, since_s: float) -> Said | None:
        """Return the first diagnostic of a node that holds the words."""
        return next((said for said in self.said if said.received_s >= since_s
                     and said.node == node and words in said.message), None)

    def stale_s(self, node: str, since_s: float) -> float:
        """Return the longest time without a diagnostic of a node."""
        times_s = [since_s, *(said.received_s for said in self.said
                              if said.received_s >= since_s and said.node == node)]
        return float(np.diff([*times_s, time.monotonic()]).max())

    def judge(self, since_s: float, until_s: float) -> tuple[int, int]:
        """Return how many attitudes were published in a time, and how many of them were wrong."""
        chosen = [attitude for attitude in self.attitudes
                  if since_s <= attitude.received_s < until_s]
        wrong = 0
        for attitude in chosen:
            truth = self._truth_at(attitude.stamp_ns)
            other = self._alone.get(attitude.stamp_ns, attitude.quaternion)
            wrong += (truth is None or not np.array_equal(other, attitude.quaternion)
                      or is_wrong(attitude.quaternion, attitude.covariance, truth))
        return len(chosen), wrong

    def _truth_at(self, stamp_ns: int) -> np.ndarray | None:
        """
        Return the true attitude, None where it is not known.

        Where a starting or dying simulator did not tell it, that of a frame near by is taken and
        turned at the constant rate.
        """
        for step in sorted(range(-_NEAR, _NEAR + 1), key=abs):
            truth = self._truth.get(stamp_ns + step * STEP_NS)
            if truth is not None:
                return multiply(truth, quaternion_from_rotation_vector(
                    np.radians(RATE_DEG_S) * -step * STEP_NS * 1e-9))
        return None

    def longest_gap_s(self, since_s: float, until_s: float) -> float:
        """Return the longest time without an attitude."""
        times_s = [since_s, *(attitude.received_s for attitude in self.attitudes
                              if since_s <= attitude.received_s < until_s), until_s]
        return float(np.diff(times_s).max())


def in_white(frame: Frame) -> Frame:
    """Return a frame with every pixel at full scale."""
    return replace(frame, image=np.full_like(
        frame.image, 2 ** DetectorOptions().bit_depth - 1))
