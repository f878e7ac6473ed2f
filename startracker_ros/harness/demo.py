"""The demo: every node a process of its own, watched live, recorded, summarised from the bag."""

from abc import ABC, abstractmethod
from collections.abc import Callable
import os
from pathlib import Path
import shutil
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
import numpy as np
import psutil
import rclpy
from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.table import Table
from sensor_msgs.msg import CameraInfo
from startracker_ros.bag.layouts import image_from_message, ns_from_stamp
from startracker_ros.extras import MissingLibraryError
from startracker_ros.figures.rows import Row
from startracker_ros.harness.processes import node_environment, NodeProcesses
from startracker_ros.machine_code import cached_functions, machine_code_folder
from startracker_ros.maths.rotation import ARCSEC, attitude_error, pointing_from_quaternion
from startracker_ros.ros import qos
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.messages.clouds import tracks_from_message
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.table import Result

if TYPE_CHECKING:
    from startracker_ros.report.recording import Recording

FRAME_RATE_HZ = 10.0
_SIMULATOR = {
    'frame_rate_hz': FRAME_RATE_HZ, 'width': 1024, 'height': 1024, 'fov_deg': 12.0,
    'motion': 'constant_rate', 'rate_deg_s': [0.05, 0.1, 0.02], 'bit_depth': 12,
    # The recorder and the extractor take images. The recorder, the extractor, the three stages
    # behind it and, once all of these have found each other, the monitor hear of the camera.
    'wait_for_subscribers': 2, 'wait_for_camera_users': 6,
    'qos_overrides./image_raw.publisher.depth': 10}
# A second of images may wait while a busy machine starts the processes: none is to be lost.
_EXTRACTOR: dict[str, object] = {
    'qos_overrides./image_raw.subscription.depth': 10}

# How many publishers and subscribers (monitor and recorder among them) complete the pipeline.
_ENDPOINTS = {'centroids': (1, 3), 'stars': (1, 2), 'tracks': (1, 2), 'tracker_state': (1, 3),
              'attitude': (1, 2)}


class DemoError(RuntimeError):
    """The demo could not be run; the text says which node failed and where its log is."""


class Monitor(Node, ABC):
    """A node by which a demo is watched."""

    @property
    @abstractmethod
    def frames(self) -> int:
        """Frames that are through."""

    @abstractmethod
    def release_when_complete(self) -> None:
        """Let the simulation begin once all nodes are connected."""

    @abstractmethod
    def table(self, frames: int) -> Table:
        """Return what there is to see now."""


class _Monitor(Monitor):
    """Listens to what a GNC process would listen to."""

    def __init__(self) -> None:
        super().__init__('demo_monitor')
        self.state = 'starting'
        self._frames = 0
        self._released = False
        self.truth: dict[int, np.ndarray] = {}
        self.attitudes: list[tuple[int, np.ndarray]] = []
        self.first_attitude_s: float | None = None
        self.create_subscription(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)
        self.create_subscription(DiagnosticStatus, 'tracker_state', self._take_state, qos.STATE)
        self.create_subscription(QuaternionStamped, 'truth/attitude', self._take_truth, qos.LIST)
        self.create_subscription(QuaternionStamped, 'attitude', self._take_attitude, qos.LIST)

    @property
    def frames(self) -> int:
        """Frames that the simulator has sent."""
        return self._frames

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'sky_simulator: simulation':
                values = {value.key: value.value for value in status.values}
                self._frames = int(values.get('frames', 0))

    def _take_state(self, message: DiagnosticStatus) -> None:
        self.state = message.message

    def _take_truth(self, message: QuaternionStamped) -> None:
        self.truth[ns_from_stamp(message.header.stamp)] = quaternion_from_message(message)

    def _take_attitude(self, message: QuaternionStamped) -> None:
        if self.first_attitude_s is None:
            self.first_attitude_s = time.time()
        self.attitudes.append((ns_from_stamp(message.header.stamp),
                               quaternion_from_message(message)))

    def release_when_complete(self) -> None:
        """Let the simulator begin, by listening to camera_info, once all nodes are connected."""
        if not self._released and all(
                self.count_publishers(topic) >= publishers
                and self.count_subscribers(topic) >= subscribers
                for topic, (publishers, subscribers) in _ENDPOINTS.items()):
            self._released = True
            self.create_subscription(CameraInfo, 'camera_info', lambda message: None, qos.LIST)

    def table(self, frames: int) -> Table:
        """Return the newest attitude, its error and the progress."""
        table = Table(title='star tracker demo', title_justify='left', min_width=70)
        for name in ('frame', 'state', 'RA deg', 'Dec deg', 'roll deg', 'error arcsec'):
            table.add_column(name, justify='right')
        progress = f'{self.frames}/{frames}'
        if not self.attitudes:
            table.add_row(progress, self.state, '-', '-', '-', '-')
            return table
        stamp_ns, quaternion = self.attitudes[-1]
        pointing = np.degrees(pointing_from_quaternion(quaternion))
        truth = self.truth.get(stamp_ns)
        error = '-' if truth is None else (
            f'{np.linalg.norm(attitude_error(quaternion, truth)[:2]) / ARCSEC:.2f}')
        table.add_row(progress, self.state, *(f'{angle:.4f}' for angle in pointing), error)
        return table


def begin_s() -> float:
    """Return when the demo began, UNIX time in s: once all is compiled, if nothing was yet."""
    folder = machine_code_folder()
    if not folder or cached_functions(folder):
        return psutil.Process().create_time()
    print('compiling for this machine, for a minute, and only once', file=sys.stderr)
    # A failure shows in the nodes, which then do it themselves.
    subprocess.run([sys.executable, '-m', 'startracker_ros.warm_up'], env=node_environment())
    return time.time()


def _clear(output: Path) -> None:
    """Remove what an earlier demo left, and nothing else."""
    bag = output / 'bag'
    if bag.exists():
        if not list(bag.glob('*.mcap')):
            raise DemoError(f'{bag} exists and holds no bag: choose another --output')
        shutil.rmtree(bag)
    shutil.rmtree(output / 'logs', ignore_errors=True)


def prepare(output: Path) -> Path:
    """Clear the output folder and set the environment; return the folder for logs."""
    logs = output / 'logs'
    try:
        _clear(output)
        logs.mkdir(parents=True)
    except OSError as error:
        raise DemoError(f'output folder {output}: {error.strerror}') from error
    # The demo hears only this machine, unless the user has chosen otherwise.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.update(node_environment())
    return logs


def end(nodes: NodeProcesses) -> None:
    """End all nodes; DemoError when one of them did not do so cleanly."""
    bad = [f'{name} (status {code})' for name, code in nodes.stop().items() if code != 0]
    if bad:
        raise DemoError(f'{", ".join(bad)} did not end cleanly: see {nodes.log_folder}')


def run_demo(output: Path, *, seconds: float, seed: int) -> Result:
    """Run the pipeline on the simulated sky; DemoError when a node fails."""
    started_s = begin_s()
    frames = round(seconds * FRAME_RATE_HZ)
    logs, bag = prepare(output), output / 'bag'
    with NodeProcesses(logs) as nodes:
        nodes.start('bag_recorder', {'folder': str(bag)})
        nodes.start('centroid_extractor', _EXTRACTOR)
        for node in ('star_identifier', 'star_tracker', 'attitude_estimator'):
            nodes.start(node)
        nodes.start('sky_simulator', {**_SIMULATOR, 'frame_count': frames, 'seed': seed})
        rclpy.init()
        monitor = _Monitor()
        try:
            watch(monitor, nodes, frames)
        finally:
            monitor.destroy_node()
            rclpy.try_shutdown()
        end(nodes)
    # Not before the nodes have started, which would wait for it.
    from startracker_ros.report.recording import load_recording
    from startracker_ros.report.summary import summarise
    recording = load_recording(bag)
    rows = summarise(recording)
    start_s = float('nan') if monitor.first_attitude_s is None else (
        monitor.first_attitude_s - started_s)
    rows.append(Row('process start to first attitude', start_s, 's', '<= 10', start_s <= 10))
    picture = output / 'demo.png'
    drawn = draw_if_possible(picture, lambda: _draw(picture, bag, recording))
    size_mb = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
    return Result('demo', rows, {
        'sky': '1024 x 1024 px, mono16 (12 bit), 12 deg field, 10 Hz, six nodes, a process each',
        'motion': 'constant rate 0.05, 0.1, 0.02 deg/s about x, y, z',
        'bag': f'{bag} ({size_mb:.0f} MB)', 'picture': drawn})


def watch(monitor: Monitor, nodes: NodeProcesses, frames: int, *,
          patience_s: float = 30.0) -> None:
    """Spin until every frame is through; DemoError when a node ends or nothing comes."""
    newest_s, seen = time.monotonic(), 0
    console = Console()
    with Live(monitor.table(frames), console=console, refresh_per_second=4) as live:
        while monitor.frames < frames:
            rclpy.spin_once(monitor, timeout_sec=0.1)
            monitor.release_when_complete()
            live.update(monitor.table(frames))
            failed = nodes.failed()
            if failed:
                raise DemoError(f'{", ".join(failed)} ended early: see {nodes.log_folder}')
            if monitor.frames > seen:
                newest_s, seen = time.monotonic(), monitor.frames
            if time.monotonic() - newest_s > patience_s:
                raise DemoError(f'no frame after number {seen} of {frames} within '
                                f'{patience_s:g} s: see {nodes.log_folder}')
    console.print()
    # What is under way may still come through.
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        rclpy.spin_once(monitor, timeout_sec=0.1)


def draw_if_possible(picture: Path, draw: Callable[[], None]) -> str:
    """Return the path of the picture, or which library drawing it needs."""
    try:
        draw()
    except MissingLibraryError as error:
        return str(error)
    return str(picture)


def _draw(path: Path, bag: Path, recording: 'Recording') -> None:
    """Draw the last frame that has both an image and tracks, and all errors."""
    from rclpy.serialization import deserialize_message
    from startracker_ros.bag.reader import read_messages
    from startracker_ros.report.picture import draw_run
    last_ns = int(np.intersect1d(recording.image_ns, recording.attitude_ns)[-1])
    image = tracks = None
    for record in read_messages(bag, topics=('/image_raw', '/tracks'),
                                start_ns=last_ns - 10 ** 9):
        message = deserialize_message(record.data, message_class(record.type_name))
        if ns_from_stamp(message.header.stamp) == last_ns:
            if record.topic == '/tracks':
                tracks = tracks_from_message(message)
            else:
                image = image_from_message(message)
    if image is None or tracks is None:
        raise DemoError(f'{bag}: no image or no tracks of the last frame with an attitude')
    draw_run(path, recording, image, tracks.uv, tracks.hip, 'star tracker demo, simulated sky')
