# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time from image to attitude through nodes, in separate processes or composed in one."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
import time

from geometry_msgs.msg import QuaternionStamped
import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, Imu
from startracker_evaluation.harness.process_sample import sample_process
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.images.images import read_image
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.serialized import deserialized
from startracker_ros.ros.probe import Progress
from startracker_ros.ros.processes import module_command, parameter_arguments
from startracker_ros.ros.rig import Rig

_SOURCE = 'image_publisher'
_SENT = f'{_SOURCE} sends'
_START_TIMEOUT_S = 120.0
_STALL_S = 2.0
_STAGE_ENDPOINTS = {
    'transport and decoding': f'{STAGES[0]} image_raw',
    'centroids': f'{STAGES[2]} centroids', 'tracking': f'{STAGES[3]} tracks'}
"""The endpoint at which each stage ends; the last one, estimate, at the subscriber of attitude."""
_COMPOSED_ENDPOINTS = {'transport and decoding': f'{STAGES[0]} image_raw'}
"""The same of one process, where all stages are one call."""

_LADDER_HZ = (5, 10, 15, 20, 25, 30, 40, 50, 60, 80, 100, 120, 150, 200, 250, 300)
_LADDER_S = 2.0
_TRIES = 2
_SLACK_S = 0.03

_RUNS = 3
"""The run with the smallest median of this many is reported: other load on the machine only
increases the times. The runs are not consecutive."""

_WARM_UP_IMAGES = 40
"""Images after which all files are read, all code is loaded and the stars are tracked."""

CAMERA_RATE_HZ = 10.0
"""A usual rate of star cameras. Processors sleep between two images, which adds a latency that
higher rates do not show."""


@dataclass(frozen=True)
class Latency:
    """
    Latencies of frames (N,) in ms, and the highest rate at which none was lost or late.

    total_ms is the sum of stages_ms: transport with decoding, then centroids, tracking and
    estimate, each with the transport to the next stage, or all stages in one process.
    camera_rate_ms is the total at CAMERA_RATE_HZ, cpu_percent the processor time of the stages at
    that rate, in percent of a core, and memory_mib their memory (Pss), both with the image source
    in a process of its own. A rate is sustained when one of _TRIES of _LADDER_S succeeds; for the
    rate of the latencies, one of the _RUNS.
    """

    total_ms: np.ndarray
    stages_ms: dict[str, np.ndarray]
    camera_rate_ms: np.ndarray
    cpu_percent: float
    memory_mib: float
    highest_hz: float


class TimedPipeline(Rig):
    """
    An image source and stages, started once and run at several rates.

    Each of the groups of nodes is a process. Without stages the images are received by the rig.
    """

    def __init__(self, images: Path, fov_deg: float, log_folder: Path,
                 groups: Sequence[Sequence[str]]) -> None:
        super().__init__(log_folder, timeout_s=_START_TIMEOUT_S)
        self._result_ns: dict[int, int] = {}
        self._processed_ns: dict[int, int] = {}
        self._frame_count = 0
        stages = [name for group in groups for name in group if name != _SOURCE]
        if stages:
            self.probe.subscribe_with_info(
                QuaternionStamped, 'attitude', self._on_attitude, qos.LIST)
            # Published for every frame, also for one without attitude.
            self.probe.subscribe_with_info(
                Imu, 'attitude_imu', self._on_attitude_imu, qos.LIST)
        else:
            self.probe.create_subscription(
                Image, 'image_raw', self._on_serialized_image, qos.LIST, raw=True)
        self._stages = [group[0] for group in groups if group != (_SOURCE,)]
        self.files = [log_folder / f'{group[0]}.npy' for group in groups]
        arguments = parameter_arguments({
            f'{_SOURCE}:path': str(images), f'{_SOURCE}:fov_deg': fov_deg,
            f'{_SOURCE}:loop': True, f'{_SOURCE}:frame_count': 1,
            # The extractor subscribes to images once it is ready.
            f'{_SOURCE}:wait_for_subscribers': 1,
            f'{_SOURCE}:wait_for_camera_users': len(stages)})
        for file, group in zip(self.files, groups):
            self.processes.run(group[0], module_command(
                'startracker_evaluation.harness.stage_times', [str(file), *group, *arguments]))

    def _on_attitude(self, message: QuaternionStamped, info: dict[str, int]) -> None:
        self._result_ns[ns_from_stamp(message.header.stamp)] = info['received_timestamp']

    def _on_attitude_imu(self, message: Imu, info: dict[str, int]) -> None:
        self._processed_ns[ns_from_stamp(message.header.stamp)] = info['received_timestamp']

    def _on_serialized_image(self, data: bytes) -> None:
        stamp_ns = ns_from_stamp(deserialized(data, Image).header.stamp)
        # The time of receipt by DDS would leave out the decoding.
        self._result_ns[stamp_ns] = self._processed_ns[stamp_ns] = time.time_ns()

    def used(self) -> tuple[float, float]:
        """Return the processor time in s of the processes of the stages, their memory in MiB."""
        samples = [sample_process(self.processes.pid(name)) for name in self._stages]
        return sum(one.cpu_s for one in samples), sum(one.proportional_mib for one in samples)

    def run(self, rate_hz: float, count: int) -> tuple[dict[int, int], dict[int, int]]:
        """
        Send count images, or one more; return times of receipt by stamp, in ns.

        The first are those of attitudes, the second those of all frames that were processed.
        HarnessError when there are none.
        """
        # A source restarts when a parameter changes: another run of equal values would not.
        count += count == self._frame_count
        self._frame_count = count
        self._result_ns.clear()
        self._processed_ns.clear()
        self.probe.call(
            SetParametersAtomically, f'{_SOURCE}/set_parameters_atomically',
            SetParametersAtomically.Request(parameters=[
                Parameter('frame_rate_hz', value=float(rate_hz)).to_parameter_msg(),
                Parameter('frame_count', value=count).to_parameter_msg()]))
        self.probe.wait(lambda: self._processed_ns, 'a processed frame')
        progress = Progress(_STALL_S)
        while (len(self._processed_ns) < count
               and not progress.is_stalled(len(self._processed_ns))):
            self.probe.spin_once(0.1)
        return dict(self._result_ns), dict(self._processed_ns)


def _is_sustained(processed_ns: dict[int, int], rate_hz: float, count: int) -> bool:
    """Return whether all frames were processed, the second half at the rate of the source."""
    if len(processed_ns) < count:
        return False
    second_ns = list(processed_ns.values())[count // 2:]
    return (second_ns[-1] - second_ns[0]) * 1e-9 < (len(second_ns) - 1) / rate_hz + _SLACK_S


def core_ms(images: Path, fov_deg: float, epoch_year: float, *, rate_hz: float, count: int
            ) -> np.ndarray:
    """Return times (N,) of the pipeline without messages, the lower bound of the latency."""
    frames = [read_image(file) for file in sorted(images.iterdir())]
    height, width = frames[0].shape
    pipeline = StarTracker(Camera.from_fov(width, height, fov_deg), epoch_year)
    times_ms = []
    for index in range(_WARM_UP_IMAGES + count):
        time.sleep(1 / rate_hz)
        start_s = time.perf_counter()
        pipeline.process(round(index / rate_hz * 1e9), frames[index % len(frames)])
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    return min(np.array_split(times_ms[_WARM_UP_IMAGES:], _RUNS), key=np.median)


def crossing_ms(images: Path, fov_deg: float, log_folder: Path, *, rate_hz: float, count: int
                ) -> np.ndarray:
    """Return times (N,) from sending an image to its receipt in another process."""
    with TimedPipeline(images, fov_deg, log_folder, [(_SOURCE,)]) as pipeline:
        pipeline.run(20, _WARM_UP_IMAGES)
        received_ns, _ = pipeline.run(rate_hz, count)
    return _since_sent_ms(received_ns, _event_times_ns(pipeline.files))


def _since_sent_ms(received_ns: dict[int, int], events_ns: dict[str, dict[int, int]]
                   ) -> np.ndarray:
    return np.array([time_ns - events_ns[_SENT][stamp_ns]
                     for stamp_ns, time_ns in received_ns.items()]) * 1e-6


def _event_times_ns(files: Sequence[Path]) -> dict[str, dict[int, int]]:
    """Return the times of the recorded events in ns, by endpoint and stamp."""
    times_ns: dict[str, dict[int, int]] = {}
    for endpoint, stamp_ns, time_ns in np.concatenate([np.load(file) for file in files]).tolist():
        times_ns.setdefault(endpoint, {})[stamp_ns] = time_ns
    return times_ns


def measure(images: Path, fov_deg: float, log_folder: Path, *, composed: bool, rate_hz: float,
            count: int) -> Latency:
    """
    Return the latency of a pipeline for the image files of a folder, repeated in a loop.

    The _RUNS at this rate have count images together. HarnessError when nothing is processed.
    """
    groups = [(_SOURCE, *STAGES)] if composed else [(name,) for name in (*STAGES, _SOURCE)]
    with TimedPipeline(images, fov_deg, log_folder, groups) as pipeline:
        pipeline.run(20, _WARM_UP_IMAGES)
        each = max(1, count // _RUNS)
        runs = [pipeline.run(rate_hz, each)]
        camera_rate_ns, cpu_percent, memory_mib = _at_camera_rate(pipeline, count)
        runs.append(pipeline.run(rate_hz, each))
        highest_hz = _highest_rate_hz(pipeline, rate_hz, any(
            _is_sustained(processed_ns, rate_hz, each) for _, processed_ns in runs))
        runs.append(pipeline.run(rate_hz, each))
    events_ns = _event_times_ns(pipeline.files)
    if composed:
        with TimedPipeline(images, fov_deg, log_folder, [STAGES, (_SOURCE,)]) as pipeline:
            pipeline.run(20, _WARM_UP_IMAGES)
            _, cpu_percent, memory_mib = _at_camera_rate(pipeline, count)
    attitude_ns = min((attitude_ns for attitude_ns, _ in runs), key=lambda run: np.median(
        _since_sent_ms(run, events_ns)) if run else np.inf)
    stages_ms = _stage_times_ms(events_ns, attitude_ns, composed)
    return Latency(np.sum(list(stages_ms.values()), axis=0), stages_ms,
                   _since_sent_ms(camera_rate_ns, events_ns), cpu_percent, memory_mib, highest_hz)


def _at_camera_rate(pipeline: TimedPipeline, count: int
                    ) -> tuple[dict[int, int], float, float]:
    """Return times of receipt by stamp, the percent of a core and the MiB that the stages use."""
    begin_s, (begin_cpu_s, _) = time.monotonic(), pipeline.used()
    received_ns, _ = pipeline.run(CAMERA_RATE_HZ, min(count, 100))
    cpu_s, memory_mib = pipeline.used()
    cpu_percent = 100 * (cpu_s - begin_cpu_s) / (time.monotonic() - begin_s)
    return received_ns, cpu_percent, memory_mib


def _highest_rate_hz(pipeline: TimedPipeline, rate_hz: float, is_sustained: bool) -> float:
    """Return the highest sustained rate of _LADDER_HZ, from rate_hz on; 0 for none."""
    def holds(step_hz: float) -> bool:
        # Other load on the machine may make a try fail.
        frames = round(step_hz * _LADDER_S)
        return any(_is_sustained(pipeline.run(step_hz, frames)[1], step_hz, frames)
                   for _ in range(_TRIES))
    if is_sustained:
        above = takewhile(holds, (step for step in _LADDER_HZ if step > rate_hz))
        return float(max((rate_hz, *above)))
    below = (step for step in reversed(_LADDER_HZ) if step < rate_hz)
    return float(next(filter(holds, below), 0))


def _stage_times_ms(events_ns: dict[str, dict[int, int]], attitude_ns: dict[int, int],
                    composed: bool) -> dict[str, np.ndarray]:
    """Return the times (N,) of each stage for the frames that were recorded at all endpoints."""
    stages = _COMPOSED_ENDPOINTS if composed else _STAGE_ENDPOINTS
    limits_ns = [events_ns[_SENT], *(events_ns[endpoint] for endpoint in stages.values()),
                 attitude_ns]
    times_ns = np.array([[times[stamp_ns] for times in limits_ns] for stamp_ns in attitude_ns
                         if all(stamp_ns in times for times in limits_ns)])
    return dict(zip((*stages, 'all stages' if composed else 'estimate'),
                    np.diff(times_ns, axis=1).T * 1e-6))
