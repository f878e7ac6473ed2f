# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many frames through node processes as fast as they are processed, with their resource use."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
import time

import numpy as np
from rich.progress import Progress
from sensor_msgs.msg import CameraInfo, Image, Imu
from startracker_evaluation.harness.process_sample import (
    ProcessSample, sample_process, shared_memory_mib)
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotation_vector_from_quaternion)
from startracker_ros.io.bags.layouts import ns_from_stamp, SENSOR_FRAME_ID
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message, image_to_message
from startracker_ros.ros.processes import HarnessError
from startracker_ros.ros.rig import Rig
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.motion_state import Motion, MotionState
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.correctness import verdict

CAMERA = Camera.from_fov(256, 256, 12.0)
NODES = (*STAGES, 'bag_recorder')
LOOP_FRAMES = 600
STEP_NS = 100_000_000
IN_FLIGHT = 2
"""Frames sent and not yet processed: the depth of the image queues."""
BAG_FILE_MB = 64.0
"""The recorder keeps the index of a file in memory until its end, so recordings are split."""
_SAMPLE_PERIOD_S = 2.0
_START_TIMEOUT_S = 600.0
_LOST_S = 30.0
_SPIN_S = 0.25
_AMPLITUDE_RAD = np.radians(2.0)


@dataclass(frozen=True)
class Nutation:
    """A boresight on a circle, closed after period_s, so that the images can be repeated."""

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
    """Counts of frames; per frame the latency; per sample the frames so far and resources."""

    frames: int = 0
    processed: int = 0
    lost: int = 0
    attitudes: int = 0
    wrong: int = 0
    gross: int = 0
    elapsed_s: float = 0.0
    latency_s: list[float] = field(default_factory=list)
    sampled_frames: list[int] = field(default_factory=list)
    shared_mib: list[float] = field(default_factory=list)
    samples: dict[str, list[ProcessSample]] = field(
        default_factory=lambda: {node: [] for node in NODES})


def loop_of_frames(seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield image (H, W) and true attitude (4,) of each frame of a closed motion."""
    motion = Nutation(
        motion_from_options(MotionOptions(motion='inertial')), LOOP_FRAMES * STEP_NS * 1e-9)
    simulator = SkySimulator(CAMERA, motion, load_catalog(),
                             epoch_year_from_stamp(time.time_ns()), seed=seed)
    for index in range(LOOP_FRAMES):
        frame = simulator.frame(index * STEP_NS * 1e-9)
        yield frame.image, frame.state.q_icrf_from_sensor


class Soak(Rig):
    """Keeps IN_FLIGHT frames in flight; samples the resources of the nodes."""

    def __init__(self, log_folder: Path, *, seed: int) -> None:
        super().__init__(log_folder)
        self._loop = list(loop_of_frames(seed))
        self.probe.create_subscription(Imu, 'attitude_imu', self._on_attitude_imu, qos.LIST)
        self._camera_info = self.probe.create_publisher(CameraInfo, 'camera_info', qos.LIST)
        self._image = self.probe.create_publisher(Image, 'image_raw', qos.IMAGE)
        for node in NODES:
            self.processes.start(node, {} if node != 'bag_recorder' else {
                'folder': str(log_folder / 'bag'), 'exclude': ['/image_raw', '*/image_annotated'],
                'max_file_size_mb': BAG_FILE_MB})
        self._begin_ns = time.time_ns()
        self._index = 0
        self._in_flight: dict[int, tuple[int, float]] = {}
        self._empty_spins = 0
        self._result = SoakResult()

    def run(self, frames: int) -> SoakResult:
        """Send frames, count and measure; HarnessError when the nodes do not work."""
        self._wait_until_working()
        self._result = result = SoakResult()
        start_s = next_sample_s = time.monotonic()
        with Progress(transient=True) as progress:
            task = progress.add_task('soak', total=frames)
            while result.frames < frames:
                while len(self._in_flight) < IN_FLIGHT and result.frames < frames:
                    self._send()
                    result.frames += 1
                self._spin()
                if time.monotonic() >= next_sample_s:
                    self._sample()
                    next_sample_s = time.monotonic() + _SAMPLE_PERIOD_S
                    progress.update(task, completed=result.frames)
        self._drain()
        self._sample()
        result.elapsed_s = time.monotonic() - start_s
        return result

    def _wait_until_working(self) -> None:
        """Send frames at less than 10 Hz until ten attitudes came that could be recorded."""
        self.probe.wait(self._is_recorded, 'the recorder to subscribe', _START_TIMEOUT_S)
        deadline_s = time.monotonic() + _START_TIMEOUT_S
        while self._result.attitudes < 10:
            if time.monotonic() > deadline_s or self.processes.ended():
                raise HarnessError(f'the nodes do not work: see {self.log_folder}')
            self._send()
            self.probe.spin_for(0.1)
        self._drain()

    def _is_recorded(self) -> bool:
        """Return whether the recorder, which subscribes to what it finds, has each stage."""
        return all(any(one.node_name == 'bag_recorder'
                       for one in self.probe.get_subscriptions_info_by_topic(topic))
                   for topic in ('centroids', 'stars', 'tracks', 'attitude_imu'))

    def _drain(self) -> None:
        """Wait until no frame is in flight."""
        while self._in_flight:
            self._spin()

    def _send(self) -> None:
        index = self._index % LOOP_FRAMES
        stamp_ns = self._begin_ns + self._index * STEP_NS
        header = make_header(stamp_ns, SENSOR_FRAME_ID)
        self._index += 1
        self._in_flight[stamp_ns] = index, time.monotonic()
        self._camera_info.publish(camera_to_message(CAMERA, header))
        self._image.publish(image_to_message(self._loop[index][0], header))

    def _on_attitude_imu(self, message: Imu) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        sent = self._in_flight.pop(stamp_ns, None)
        if sent is None:
            return
        index, sent_s = sent
        result = self._result
        # Frames are processed in their order: earlier ones are lost.
        for earlier_ns in [key for key in self._in_flight if key < stamp_ns]:
            del self._in_flight[earlier_ns]
            result.lost += 1
        result.processed += 1
        result.latency_s.append(time.monotonic() - sent_s)
        tracked = tracked_attitude_from_imu(message)
        if tracked is not None:
            attitude = tracked.attitude
            result.attitudes += 1
            found = verdict(attitude.quaternion, attitude.covariance_sensor, self._loop[index][1])
            result.wrong += found.wrong
            result.gross += found.gross

    def _spin(self) -> None:
        """
        Process one message; frames in flight are lost after _LOST_S of spins without result.

        Spins are counted, because time also passes while the whole machine is suspended.
        """
        processed = self._result.processed
        self.probe.spin_once(_SPIN_S)
        self._empty_spins = 0 if self._result.processed > processed else self._empty_spins + 1
        if self._empty_spins > _LOST_S / _SPIN_S:
            self._result.lost += len(self._in_flight)
            self._in_flight.clear()
            self._empty_spins = 0

    def _sample(self) -> None:
        result = self._result
        result.sampled_frames.append(result.processed)
        for node in NODES:
            result.samples[node].append(sample_process(self.processes.pid(node)))
        result.shared_mib.append(shared_memory_mib([self.processes.pid(node) for node in NODES]))
