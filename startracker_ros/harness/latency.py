"""From image to attitude through real nodes, in separate processes or composed into one."""

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

from startracker_ros.bag.layouts import ns_from_stamp
from startracker_ros.camera.images import read_image
from startracker_ros.camera.model import Camera
from startracker_ros.executables import STAGES
from startracker_ros.harness.processes import parameter_arguments, RigError
from startracker_ros.harness.rig import Rig
from startracker_ros.pipeline.pipeline import Pipeline
from startracker_ros.ros.messages.image import image_message_from_cdr

_SOURCE = 'image_publisher'
_SENDS = f'{_SOURCE} sends'
_PATIENCE_S = 30.0
_PLACES = {
    'transport and decoding': f'{STAGES[0]} image_raw',
    'centroids': f'{STAGES[2]} centroids', 'tracking': f'{STAGES[3]} tracks'}
"""Where each stage ends and the next one begins; the last one ends with the subscriber."""

_LADDER_HZ = (5, 10, 15, 20, 25, 30, 40, 50, 60, 80, 100, 120, 150, 200, 250, 300)
_LADDER_S = 2.0
_TRIES = 2
_SLACK_S = 0.03

_RUNS = 3
"""The times are those of the run with the least median, of so many with other runs in between:
what a machine, or its host, does beside only makes them longer."""

_UNTIL_STEADY = 40
"""Images after which all files are read, all code is compiled and the stars are tracked."""

UNHURRIED_HZ = 10.0
"""A pace of many star cameras. Processors go to sleep in the pauses, so that no faster one
tells how long these images take."""


@dataclass(frozen=True)
class Latency:
    """
    Times of frames in ms, and the highest rate at which none was lost or late.

    stages_ms holds the transport with decoding, centroids, tracking and estimate, each with the
    way to the next one; unhurried_ms the whole at UNHURRIED_HZ. A rate counts when one of _TRIES
    of _LADDER_S succeeds, the rate that the times were taken at when one of their _RUNS does.
    """

    total_ms: np.ndarray
    stages_ms: dict[str, np.ndarray]
    unhurried_ms: np.ndarray
    highest_hz: float


class TimedPipeline(Rig):
    """
    An image source and the stages behind it, started once and fed at several rates.

    Without stages the images themselves are what arrives.
    """

    def __init__(self, images: Path, fov_deg: float, folder: Path, *, composed: bool = False,
                 stages: Sequence[str] = STAGES) -> None:
        super().__init__(folder)
        self._arrived_ns: dict[int, int] = {}
        self._through_ns: dict[int, int] = {}
        if stages:
            self.listen(QuaternionStamped, 'attitude', self._take)
            # This one also comes for a frame that has no attitude.
            self.listen(Imu, 'attitude_imu', self._count)
        else:
            self.listen(Image, 'image_raw', self._take_image, raw=True)
        self._source = self.node.create_client(
            SetParametersAtomically, f'{_SOURCE}/set_parameters_atomically')
        groups = [(_SOURCE, *stages)] if composed else [(name,) for name in (*stages, _SOURCE)]
        self.files = [folder / f'{group[0]}.npy' for group in groups]
        arguments = parameter_arguments({
            f'{_SOURCE}:path': str(images), f'{_SOURCE}:fov_deg': fov_deg,
            f'{_SOURCE}:loop': True, f'{_SOURCE}:frame_count': 1,
            # The extractor takes images only once it has loaded what is compiled.
            f'{_SOURCE}:wait_for_subscribers': 1,
            f'{_SOURCE}:wait_for_camera_users': len(stages),
            'qos_overrides./image_raw.publisher.depth': 10,
            'qos_overrides./image_raw.subscription.depth': 10})
        for file, group in zip(self.files, groups):
            self.start_module(group[0], 'startracker_ros.harness.stage_times',
                              [str(file), *group, *arguments])

    def _take(self, message: QuaternionStamped, info: dict[str, int]) -> None:
        self._arrived_ns[ns_from_stamp(message.header.stamp)] = info['received_timestamp']

    def _count(self, message: Imu, info: dict[str, int]) -> None:
        self._through_ns[ns_from_stamp(message.header.stamp)] = info['received_timestamp']

    def _take_image(self, data: bytes) -> None:
        stamp_ns = ns_from_stamp(image_message_from_cdr(data).header.stamp)
        # Not when DDS had it: by now it is decoded as well.
        self._arrived_ns[stamp_ns] = self._through_ns[stamp_ns] = time.time_ns()

    def run(self, rate_hz: float, count: int) -> tuple[dict[int, int], dict[int, int]]:
        """
        Send so many images; return stamps and arrivals in ns.

        The first are those of attitudes, the second those of all frames that came through.
        """
        arrived_ns, through_ns = self._arrived_ns, self._through_ns
        arrived_ns.clear()
        through_ns.clear()
        self._ask({'frame_rate_hz': float(rate_hz), 'frame_count': count})
        newest_s, seen = time.monotonic(), 0
        # Done when all are through, or when nothing has come for a while.
        while seen < count and time.monotonic() < newest_s + (2.0 if seen else _PATIENCE_S):
            self.spin(0.1)
            if len(through_ns) > seen:
                newest_s, seen = time.monotonic(), len(through_ns)
        if not seen:
            raise RigError(f'nothing comes through within {_PATIENCE_S:g} s: see {self.folder}')
        return dict(arrived_ns), dict(through_ns)

    def _ask(self, parameters: dict[str, object]) -> None:
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg()
            for name, value in parameters.items()])
        deadline_s = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline_s:
            if not self._source.service_is_ready():
                self.spin(0.1)
                continue
            future = self._source.call_async(request)
            again_s = time.monotonic() + 3.0
            while not future.done() and time.monotonic() < again_s:
                self.spin(0.1)
            if future.done():
                return
        raise RigError(f'the image source does not answer: see {self.folder}')


def _holds(through_ns: dict[int, int], rate_hz: float, count: int) -> bool:
    """Return whether every frame came through, the second half at the pace of the source."""
    if len(through_ns) < count:
        return False
    second_ns = list(through_ns.values())[count // 2:]
    return (second_ns[-1] - second_ns[0]) * 1e-9 < (len(second_ns) - 1) / rate_hz + _SLACK_S


def core_ms(images: Path, fov_deg: float, epoch_year: float, *, rate_hz: float, count: int
            ) -> np.ndarray:
    """Return times (N,) of the core alone, the floor of any way through messages."""
    frames = [read_image(file) for file in sorted(images.iterdir())]
    height, width = frames[0].shape
    pipeline = Pipeline(Camera.from_fov(width, height, fov_deg), epoch_year)
    times_ms = []
    for index in range(_UNTIL_STEADY + count):
        time.sleep(1 / rate_hz)
        start_s = time.perf_counter()
        pipeline.update_image(round(index / rate_hz * 1e9), frames[index % len(frames)])
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    return min(np.array_split(times_ms[_UNTIL_STEADY:], _RUNS), key=np.median)


def crossing_ms(images: Path, fov_deg: float, folder: Path, *, rate_hz: float, count: int
                ) -> np.ndarray:
    """Return times (N,) from sending an image to a listener that does nothing with it."""
    with TimedPipeline(images, fov_deg, folder, stages=()) as pipeline:
        pipeline.run(20, _UNTIL_STEADY)
        arrived_ns, _ = pipeline.run(rate_hz, count)
    return _since_sent_ms(arrived_ns, _passed(pipeline.files))


def _since_sent_ms(arrived_ns: dict[int, int], passed: dict[str, dict[int, int]]) -> np.ndarray:
    return np.array([at_ns - passed[_SENDS][stamp_ns]
                     for stamp_ns, at_ns in arrived_ns.items()]) * 1e-6


def _passed(files: Sequence[Path]) -> dict[str, dict[int, int]]:
    """Return when what was noted in files passed, in ns, by place and stamp."""
    passed: dict[str, dict[int, int]] = {}
    for place, stamp_ns, time_ns in np.concatenate([np.load(file) for file in files]).tolist():
        passed.setdefault(place, {})[stamp_ns] = time_ns
    return passed


def measure(images: Path, fov_deg: float, folder: Path, *, composed: bool, rate_hz: float,
            count: int) -> Latency:
    """
    Feed a pipeline the image files of a folder, in a loop; RigError if it does not run.

    The _RUNS at this rate have count images together.
    """
    with TimedPipeline(images, fov_deg, folder, composed=composed) as pipeline:
        pipeline.run(20, _UNTIL_STEADY)
        each = max(1, count // _RUNS)
        runs = [pipeline.run(rate_hz, each)]
        unhurried_ns, _ = pipeline.run(UNHURRIED_HZ, min(count, 100))
        runs.append(pipeline.run(rate_hz, each))

        def holds(step_hz: float) -> bool:
            # Tried again, as other work of the machine may have been in the way.
            frames = round(step_hz * _LADDER_S)
            return any(_holds(pipeline.run(step_hz, frames)[1], step_hz, frames)
                       for _ in range(_TRIES))
        if any(_holds(through_ns, rate_hz, each) for _, through_ns in runs):
            above = takewhile(holds, (step for step in _LADDER_HZ if step > rate_hz))
            highest_hz = max((rate_hz, *above))
        else:
            below = (step for step in reversed(_LADDER_HZ) if step < rate_hz)
            highest_hz = next(filter(holds, below), 0)
        runs.append(pipeline.run(rate_hz, each))
    passed = _passed(pipeline.files)
    arrived_ns = min((arrived_ns for arrived_ns, _ in runs),
                     key=lambda run: np.median(_since_sent_ms(run, passed)) if run else np.inf)
    passed['arrived'] = arrived_ns
    stages = {name: place for name, place in _PLACES.items() if place in passed}
    places = [_SENDS, *stages.values(), 'arrived']
    times_ns = np.array([[passed[place][stamp_ns] for place in places]
                         for stamp_ns in arrived_ns
                         if all(stamp_ns in passed[place] for place in places)])
    steps_ms = np.diff(times_ns, axis=1) * 1e-6
    return Latency(steps_ms.sum(axis=1), dict(zip((*stages, 'estimate'), steps_ms.T)),
                   _since_sent_ms(unhurried_ns, passed), float(highest_hz))
