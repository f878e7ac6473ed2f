# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A star tracker in node processes, fed with simulated images; its attitudes are verified."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
import time

from geometry_msgs.msg import PoseWithCovarianceStamped, QuaternionStamped
import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)
from startracker_ros.io.bags.layouts import INERTIAL_FRAME_ID, ns_from_stamp, SENSOR_FRAME_ID
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import attitude_from_pose, quaternion_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message, image_to_message
from startracker_ros.ros.rig import Rig
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.correctness import verdict, WrongCount

CAMERA = Camera.from_fov(512, 512, 12.0)
FRAME_RATE_HZ = 10.0
STEP_NS = round(1e9 / FRAME_RATE_HZ)
RATE_DEG_S = (0.05, 0.1, 0.02)
_RECOVERED_FRAMES = 5
"""Consecutive frames with an attitude that count as a recovery."""
_TRUTH_STEPS = 10
"""Frames over which a missing truth is extrapolated; restarts are further apart."""
_LARGEST_BACKLOG_S = 0.5


@dataclass(frozen=True)
class Frame:
    """What the camera publishes: the camera, image (H, W), stamp, true attitude (4,)."""

    camera: Camera
    image: np.ndarray
    stamp_ns: int
    truth: np.ndarray


@dataclass(frozen=True)
class Attitude:
    """A published attitude (4,), covariance (3, 3) about sensor axes, time of receipt."""

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray
    received_s: float


class FaultRig(Rig):
    """
    Publishes images at FRAME_RATE_HZ, unless a sky_simulator does, and verifies the attitudes.

    frame_filter returns the frames that are published for one of the camera; clock_offset_ns is
    added to the stamps. Times are those of the monotonic clock in s.
    """

    def __init__(self, log_folder: Path, *, seed: int, environment: dict[str, str] | None = None
                 ) -> None:
        super().__init__(log_folder, environment)
        self.seed = seed
        self.sent_s: dict[int, float] = {}
        self.started_s: dict[str, float] = {}
        self.attitudes: list[Attitude] = []
        self._truth: dict[int, np.ndarray] = {}
        self._quaternions: dict[int, np.ndarray] = {}
        probe = self.probe
        probe.collect_diagnostics()
        probe.create_subscription(
            PoseWithCovarianceStamped, 'attitude_cov', self._on_attitude_cov, qos.LIST)
        probe.create_subscription(QuaternionStamped, 'attitude', self._on_attitude, qos.LIST)
        probe.create_subscription(
            QuaternionStamped, 'truth/attitude', self._on_truth_attitude, qos.LIST)
        self._camera_info = probe.create_publisher(CameraInfo, 'camera_info', qos.LIST)
        self._image = probe.create_publisher(Image, 'image_raw', qos.IMAGE)
        self.publishes_images = True
        self.frame_filter: Callable[[Frame], list[Frame]] = lambda frame: [frame]
        self.clock_offset_ns = 0
        self._begin_ns = time.time_ns()
        self._index = 0
        self._next_s = time.monotonic()
        self.set_camera(CAMERA)

    def set_camera(self, camera: Camera) -> None:
        """Simulate the following images with a camera."""
        self._camera = camera
        motion = motion_from_options(MotionOptions(
            motion='constant_rate', rate_deg_s=RATE_DEG_S))
        self._simulator = SkySimulator(
            camera, motion, load_catalog(), epoch_year_from_stamp(self._begin_ns), seed=self.seed)

    @property
    def stamp_ns(self) -> int:
        """Return the stamp of the newest frame."""
        return self._begin_ns + self._index * STEP_NS + self.clock_offset_ns

    @property
    def bag(self) -> Path:
        """Return the newest bag."""
        return max(self.log_folder.glob('bag_[0-9]*'), key=lambda path: path.stat().st_mtime_ns)

    def start(self, node: str) -> None:
        """Start a node, or start it again; a bag_recorder writes a new bag."""
        parameters: dict[str, object] = {}
        if node == 'sky_simulator':
            parameters = {'width': CAMERA.width, 'height': CAMERA.height, 'fov_deg': 12.0,
                          'motion': 'constant_rate', 'rate_deg_s': list(RATE_DEG_S),
                          'frame_rate_hz': FRAME_RATE_HZ, 'seed': self.seed}
        elif node == 'bag_recorder':
            number = len(list(self.log_folder.glob('bag_[0-9]*')))
            parameters = {'folder': str(self.log_folder / f'bag_{number}'),
                          'exclude': ['/image_raw', '*/image_annotated']}
        self.started_s[node] = time.monotonic()
        self.processes.start(node, parameters)

    # --- images ---

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Publish images for a time or until a condition is true; return its value."""
        deadline_s = time.monotonic() + seconds
        while not until():
            now_s = time.monotonic()
            if now_s >= deadline_s:
                return False
            if now_s >= self._next_s:
                self._next_s = max(self._next_s + STEP_NS * 1e-9, now_s - _LARGEST_BACKLOG_S)
                if self.publishes_images:
                    self._publish_frame()
            wait_s = min(self._next_s, deadline_s) - time.monotonic()
            self.probe.spin_once(max(0.0, min(wait_s, 0.05)))
        return True

    def _publish_frame(self) -> None:
        self._index += 1
        simulated = self._simulator.frame(self._index * STEP_NS * 1e-9)
        for frame in self.frame_filter(Frame(
                self._camera, simulated.image, self.stamp_ns,
                simulated.state.q_icrf_from_sensor)):
            header = make_header(frame.stamp_ns, SENSOR_FRAME_ID)
            self._truth[frame.stamp_ns] = frame.truth
            self.sent_s[frame.stamp_ns] = time.monotonic()
            self._camera_info.publish(camera_to_message(frame.camera, header))
            self._image.publish(image_to_message(frame.image, header))

    def _on_truth_attitude(self, message: QuaternionStamped) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._truth[stamp_ns] = quaternion_from_message(message)
        self.sent_s[stamp_ns] = time.monotonic()

    # --- attitudes ---

    def _on_attitude(self, message: QuaternionStamped) -> None:
        self._quaternions[ns_from_stamp(message.header.stamp)] = quaternion_from_message(message)

    def _on_attitude_cov(self, message: PoseWithCovarianceStamped) -> None:
        quaternion, covariance = attitude_from_pose(message, INERTIAL_FRAME_ID)
        matrix = matrix_from_quaternion(quaternion)
        self.attitudes.append(Attitude(
            ns_from_stamp(message.header.stamp), quaternion,
            matrix.T @ covariance @ matrix, time.monotonic()))

    def recovered_s(self, since_s: float) -> float | None:
        """
        Return when the attitudes recovered, None for not yet.

        That is the receipt of the first of _RECOVERED_FRAMES attitudes of consecutive frames
        sent after since_s.
        """
        received_s = {attitude.stamp_ns: attitude.received_s for attitude in self.attitudes
                      if attitude.received_s >= since_s}
        run: list[int] = []
        for stamp_ns, sent_s in self.sent_s.items():
            if sent_s >= since_s:
                run = [*run, stamp_ns] if stamp_ns in received_s else []
                if len(run) == _RECOVERED_FRAMES:
                    return received_s[run[0]]
        return None

    def wait_recovered(self, since_s: float, timeout_s: float) -> float | None:
        """Run until recovered_s() is known and return it, None after timeout_s."""
        self.run(timeout_s, lambda: self.recovered_s(since_s) is not None)
        return self.recovered_s(since_s)

    def count_attitudes(self, since_s: float, until_s: float) -> tuple[int, WrongCount]:
        """
        Return the numbers of attitudes received in an interval and of the wrong and gross ones.

        Wrong is also one of unknown truth, or one that differs between the two topics.
        """
        received = [attitude for attitude in self.attitudes
                    if since_s <= attitude.received_s < until_s]
        wrong = gross = 0
        for attitude in received:
            truth = self._truth_at(attitude.stamp_ns)
            other = self._quaternions.get(attitude.stamp_ns, attitude.quaternion)
            found = WrongCount(1, 1)
            if truth is not None and np.array_equal(other, attitude.quaternion):
                found = verdict(attitude.quaternion, attitude.covariance, truth)
            wrong += found.wrong
            gross += found.gross
        return len(received), WrongCount(wrong, gross)

    def _truth_at(self, stamp_ns: int) -> np.ndarray | None:
        """
        Return the true attitude (4,), None where it is unknown.

        A starting or killed simulator may not have published it: the truth of the nearest frame
        is then extrapolated at the constant rate.
        """
        for step in sorted(range(-_TRUTH_STEPS, _TRUTH_STEPS + 1), key=abs):
            truth = self._truth.get(stamp_ns + step * STEP_NS)
            if truth is not None:
                return multiply(truth, quaternion_from_rotation_vector(
                    np.radians(RATE_DEG_S) * -step * STEP_NS * 1e-9))
        return None

    def longest_gap_s(self, since_s: float, until_s: float) -> float:
        """Return the longest time without an attitude in an interval."""
        times_s = [since_s, *(attitude.received_s for attitude in self.attitudes
                              if since_s <= attitude.received_s < until_s), until_s]
        return float(np.diff(times_s).max())


def saturated(frame: Frame) -> Frame:
    """Return a frame with every pixel at full scale."""
    return replace(frame, image=np.full_like(
        frame.image, 2 ** DetectorOptions().bit_depth - 1))
