# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of one star tracker: six nodes on the simulated sky, one process each."""

from pathlib import Path
import time
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
import numpy as np
from rich.table import Table
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, pointing_from_quaternion
from startracker_ros.io.bags.layouts import image_from_message, ns_from_stamp
from startracker_ros.io.table import Result
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import quaternion_from_message
from startracker_ros.ros.processes import HarnessError
from startracker_ros.tools.demos.live_demo import (
    Demo, draw_if_possible, read_stamped, start_time_s)
from startracker_ros.tools.demos.readiness import needs_of
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import DemoRow

if TYPE_CHECKING:
    from startracker_ros.io.recordings.recording import Recording

FRAME_RATE_HZ = 10.0
_SIMULATOR = {
    'frame_rate_hz': FRAME_RATE_HZ, 'width': 1024, 'height': 1024, 'fov_deg': 12.0,
    'motion': 'constant_rate', 'rate_deg_s': [0.05, 0.1, 0.02], 'bit_depth': 12,
    # Images: the recorder and the extractor. camera_info: the recorder, the extractor, the three
    # other stages and, once all nodes are ready, the demo.
    'wait_for_subscribers': 2, 'wait_for_camera_users': 6,
    # Fewer than the queues hold, so that a slow stage loses none.
    'frames_ahead': 5}


class StarTrackerDemo(Demo):
    """The pipeline of one star tracker; compares its attitudes with the truth."""

    endpoints = {
        'image_raw': (1, 2), 'imu': (1, 2), 'truth/attitude': (1, 2), 'truth/stars': (1, 1),
        'truth/odometry': (1, 1), 'centroids': (1, 3), 'stars': (1, 2), 'tracks': (1, 2),
        'tracked_attitude': (1, 2), 'predicted_centroids': (1, 2), 'tracker_state': (1, 3),
        'attitude': (1, 2), 'attitude_cov': (1, 1), 'attitude_imu': (1, 2)}
    needs = needs_of(('bag_recorder', 'sky_simulator', *STAGES))

    def __init__(self, output: Path) -> None:
        super().__init__(output)
        self.first_attitude_s: float | None = None
        self._state = 'starting'
        self._truth: dict[int, np.ndarray] = {}
        self._newest: tuple[int, np.ndarray] | None = None
        subscribe = self.probe.create_subscription
        subscribe(DiagnosticStatus, 'tracker_state', self._on_tracker_state, qos.STATE)
        subscribe(QuaternionStamped, 'truth/attitude', self._on_truth_attitude, qos.LIST)
        subscribe(QuaternionStamped, 'attitude', self._on_attitude, qos.LIST)

    def start(self, frames: int, seed: int) -> None:
        """Start all nodes."""
        self.processes.start('bag_recorder', {'folder': str(self.bag)})
        for node in STAGES:
            self.processes.start(node)
        self.processes.start('sky_simulator', {**_SIMULATOR, 'frame_count': frames, 'seed': seed})

    @property
    def frames(self) -> int:
        """Frames that were simulated."""
        return self.simulated_frames()

    def _on_tracker_state(self, message: DiagnosticStatus) -> None:
        self._state = message.message

    def _on_truth_attitude(self, message: QuaternionStamped) -> None:
        self._truth[ns_from_stamp(message.header.stamp)] = quaternion_from_message(message)

    def _on_attitude(self, message: QuaternionStamped) -> None:
        if self.first_attitude_s is None:
            self.first_attitude_s = time.time()
        self._newest = ns_from_stamp(message.header.stamp), quaternion_from_message(message)

    def table(self, frames: int) -> Table:
        """Return the newest attitude, its error and the progress."""
        table = Table(title='star tracker demo', title_justify='left', min_width=70)
        for name in ('frame', 'state', 'RA deg', 'Dec deg', 'roll deg', 'error arcsec'):
            table.add_column(name, justify='right')
        progress = f'{self.frames}/{frames}'
        if self._newest is None:
            table.add_row(progress, self._state, '-', '-', '-', '-')
            return table
        stamp_ns, quaternion = self._newest
        pointing = np.degrees(pointing_from_quaternion(quaternion))
        truth = self._truth.get(stamp_ns)
        error = '-' if truth is None else (
            f'{np.linalg.norm(attitude_error(quaternion, truth)[:2]) / ARCSEC:.2f}')
        table.add_row(progress, self._state, *(f'{angle:.4f}' for angle in pointing), error)
        return table


def run_demo(output: Path, *, seconds: float, seed: int) -> Result:
    """Run the pipeline on the simulated sky; HarnessError when a node fails."""
    began_s = start_time_s()
    frames = round(seconds * FRAME_RATE_HZ)
    with StarTrackerDemo(output) as demo:
        demo.start(frames, seed)
        demo.watch(frames)
        demo.finish()
    # Imported here, because it would delay the start of the nodes.
    from startracker_ros.io.recordings.loading import load_recording
    from startracker_ros.tools.report.summary import summarise
    recording = load_recording(demo.bag)
    rows = summarise(recording, frames)
    start_s = float('nan') if demo.first_attitude_s is None else demo.first_attitude_s - began_s
    rows.append(DemoRow.with_goal('process start to first attitude', start_s, 's', 10.0))
    picture = output / 'demo.png'
    drawn = draw_if_possible(picture, lambda: _draw(picture, demo.bag, recording))
    return Result('demo', rows, {
        'sky': '1024 x 1024 px, mono16 (12 bit), 12 deg field, 10 Hz, six nodes, a process each',
        'motion': 'constant rate 0.05, 0.1, 0.02 deg/s about x, y, z',
        'machine': machine(str(demo.load)), 'bag': demo.bag_text(), 'picture': drawn})


def _draw(path: Path, bag: Path, recording: 'Recording') -> None:
    """Draw the last frame that has an image and an attitude, and all errors."""
    from startracker_ros.ros.messages.clouds import tracks_from_message
    from startracker_ros.tools.report.summary import draw_run
    last_ns = int(np.intersect1d(recording.image_ns, recording.attitude_ns)[-1])
    frame = {record.topic: message for record, stamp_ns, message in read_stamped(
        bag, ('/image_raw', '/tracks'), last_ns - 10 ** 9) if stamp_ns == last_ns}
    if len(frame) < 2:
        raise HarnessError(f'{bag}: no image or no tracks of the last frame with an attitude')
    tracks = tracks_from_message(frame['/tracks'])
    draw_run(path, recording, image_from_message(frame['/image_raw']).pixels, tracks.uv,
             tracks.hip, 'star tracker demo, simulated sky')
