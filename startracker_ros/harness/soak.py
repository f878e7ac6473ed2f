"""Many frames through real nodes, as fast as these take them, with an eye on what they hold."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
import time

import numpy as np
from rich.progress import Progress
from sensor_msgs.msg import CameraInfo, Image, Imu

from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.executables import STAGES
from startracker_ros.figures.correctness import is_wrong
from startracker_ros.harness.process_sample import ProcessSample, sample_process, shared_memory_mib
from startracker_ros.harness.processes import RigError
from startracker_ros.harness.rig import Rig
from startracker_ros.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotation_vector_from_quaternion)
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.camera_info import camera_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import image_to_message
from startracker_ros.sky.motion import Motion, motion_from_options, MotionOptions, MotionState
from startracker_ros.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(256, 256, 12.0)
NODES = (*STAGES, 'bag_recorder')
LOOP_FRAMES = 600
STEP_NS = 100_000_000
IN_FLIGHT = 2
"""Frames under way at a time, as many as the queues of images hold."""
BAG_FILE_MB = 64.0
"""The index of a file is held until its end, so that long recordings are split."""
_SAMPLE_PERIOD_S = 2.0
_START_PATIENCE_S = 600.0
_LOST_S = 30.0
_WAIT_S = 0.25
_AMPLITUDE_RAD = np.radians(2.0)


@dataclass(frozen=True)
class Nutation:
    """A boresight on a circle, once round in a loop of frames, so that images can be repeated."""

    centre: Motion
    period_s: float

    def at(self, time_s: float) -> MotionState:
        """Return the state; the rate is the difference of two attitudes a ms apart."""
        before, now, after = (self._attitude(time_s + step_s) for step_s in (-5e-4, 0.0, 5e-4))
        rate_rad_s = rotation_vector_from_quaternion(multiply(conjugate(before), after)) / 1e-3
        return replace(self.centre.at(0.0), q_icrf_from_sensor=now, rate_rad_s=rate_rad_s)

    def _attitude(self, time_s: float) -> np.ndarray:
        phase = 2 * np.pi * time_s / self.period_s
        return multiply(self.centre.at(0.0).q_icrf_from_sensor, quaternion_from_rotation_vector(
            _AMPLITUDE_RAD * np.array([np.sin(phase), np.cos(phase), 0.0])))


@dataclass
class SoakResult:
    """What was seen: per sample the frames so far and each node's state; per frame times."""

    frames: int = 0
    answered: int = 0
    lost: int = 0
    attitudes: int = 0
    wrong: int = 0
    elapsed_s: float = 0.0
    latency_s: list[float] = field(default_factory=list)
    sampled_frames: list[int] = field(default_factory=list)
    shared_mib: list[float] = field(default_factory=list)
    samples: dict[str, list[ProcessSample]] = field(
        default_factory=lambda: {node: [] for node in NODES})


def loop_of_frames(seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield image (H, W) and true attitude (4,) of the frames of a closed motion."""
    motion = Nutation(
        motion_from_options(MotionOptions(motion='inertial')), LOOP_FRAMES * STEP_NS * 1e-9)
    simulator = SkySimulator(CAMERA, motion, load_catalog(),
                             epoch_year_from_stamp(time.time_ns()), seed=seed)
    for index in range(LOOP_FRAMES):
        frame = simulator.frame(index * STEP_NS * 1e-9)
        yield frame.image, frame.state.q_icrf_from_sensor


class Soak(Rig):
    """Sends a frame when the one before the last is answered; samples the nodes."""

    def __init__(self, folder: Path, *, seed: int) -> None:
        super().__init__(folder)
        self._loop = list(loop_of_frames(seed))
        self.listen(Imu, 'attitude_imu', self._take_answer)
        self._camera_info = self.node.create_publisher(CameraInfo, 'camera_info', qos.LIST)
        self._image = self.node.create_publisher(Image, 'image_raw', qos.IMAGE)
        for node in NODES:
            self.start_node(node, {} if node != 'bag_recorder' else {
                'folder': str(folder / 'bag'), 'exclude': ['/image_raw', '*/image_annotated'],
                'max_file_size_mb': BAG_FILE_MB})
        self._begin_ns = time.time_ns()
        self._index = 0
        self._under_way: dict[int, tuple[int, float]] = {}
        self._waits = 0
        self._result = SoakResult()

    def run(self, frames: int) -> SoakResult:
        """Send so many frames, count and measure; RigError when the nodes do not work."""
        self._begin()
        self._result = result = SoakResult()
        start_s = next_sample_s = time.monotonic()
        with Progress(transient=True) as progress:
            task = progress.add_task('soak', total=frames)
            while result.frames < frames:
                while len(self._under_way) < IN_FLIGHT and result.frames < frames:
                    self._send()
                    result.frames += 1
                self._wait()
                if time.monotonic() >= next_sample_s:
                    self._sample()
                    next_sample_s = time.monotonic() + _SAMPLE_PERIOD_S
                    progress.update(task, completed=result.frames)
        self._settle()
        self._sample()
        result.elapsed_s = time.monotonic() - start_s
        return result

    def _begin(self) -> None:
        """Send a frame now and then until there are attitudes."""
        deadline_s = time.monotonic() + _START_PATIENCE_S
        while self._result.attitudes < 10:
            if time.monotonic() > deadline_s or not all(map(self.runs, NODES)):
                raise RigError(f'the nodes do not work: see {self.folder}')
            self._send()
            again_s = time.monotonic() + 0.1
            while time.monotonic() < again_s:
                self.spin(0.02)
        self._settle()

    def _settle(self) -> None:
        """Wait for the frames under way."""
        while self._under_way:
            self._wait()

    def _send(self) -> None:
        index = self._index % LOOP_FRAMES
        stamp_ns = self._begin_ns + self._index * STEP_NS
        header = make_header(stamp_ns, 'star_tracker_optical_frame')
        self._index += 1
        self._under_way[stamp_ns] = index, time.monotonic()
        self._camera_info.publish(camera_to_message(CAMERA, header))
        self._image.publish(image_to_message(self._loop[index][0], header))

    def _take_answer(self, message: Imu) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        sent = self._under_way.pop(stamp_ns, None)
        if sent is None:
            return
        index, sent_s = sent
        result = self._result
        # Answers come in the order of the frames.
        for passed_over in [under_way for under_way in self._under_way if under_way < stamp_ns]:
            del self._under_way[passed_over]
            result.lost += 1
        result.answered += 1
        result.latency_s.append(time.monotonic() - sent_s)
        tracked = tracked_attitude_from_imu(message)
        if tracked is not None:
            attitude = tracked.attitude
            result.attitudes += 1
            result.wrong += is_wrong(
                attitude.quaternion, attitude.covariance_sensor, self._loop[index][1])

    def _wait(self) -> None:
        """
        Take an answer; frames are lost when many waits in a row have brought none.

        Waits are counted and not the time, of which any amount passes when all is stopped.
        """
        answered = self._result.answered
        self.spin(_WAIT_S)
        self._waits = 0 if self._result.answered > answered else self._waits + 1
        if self._waits > _LOST_S / _WAIT_S:
            self._result.lost += len(self._under_way)
            self._under_way.clear()
            self._waits = 0

    def _sample(self) -> None:
        result = self._result
        result.sampled_frames.append(result.answered)
        for node in NODES:
            result.samples[node].append(sample_process(self.pid(node)))
        result.shared_mib.append(shared_memory_mib([self.pid(node) for node in NODES]))
