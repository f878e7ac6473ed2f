# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of two satellites that locate a third: twelve processes, recorded and summarised."""

from datetime import datetime, timedelta, UTC
from functools import partial
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
from rich.table import Table
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit, orbit_frame
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.io.bags.layouts import image_from_message, ns_from_stamp
from startracker_ros.io.table import Result
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.clouds import centroids_from_message, tracks_from_message
from startracker_ros.ros.processes import HarnessError
from startracker_ros.sim.sky.target import Target, TargetOptions
from startracker_ros.tools.demos.live_demo import (
    Demo, draw_if_possible, read_stamped, start_time_s)
from startracker_ros.tools.demos.readiness import needs_of
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import DemoRow
from startracker_ros.tools.report.target import draw_target, load_target, summarise_target

FRAME_RATE_HZ = 2.0
OBSERVERS = ('tracker_1', 'tracker_2')

# The frames of the second camera lie between those of the first.
_START_OFFSETS_S = (0.0, 0.2)
_START = datetime(2026, 8, 25, 18, tzinfo=UTC)
_ORBIT = {'altitude_km': 700.0, 'inclination_deg': 30.0, 'node_deg': 40.0}
_LATITUDES_DEG = (-2.0, 2.0)
_TARGET = {'target_altitude_km': 1090.0, 'target_inclination_deg': 33.0, 'target_node_deg': 40.0,
           'target_magnitude': 5.0}
_COMMON = {
    'frame_rate_hz': FRAME_RATE_HZ, 'width': 1024, 'height': 1024, 'fov_deg': 12.0,
    'bit_depth': 12, 'aberration': True, 'motion': 'low_earth_orbit', 'motion_smear': True,
    'target': True, **_ORBIT, **_TARGET,
    # Images: the recorder and the extractor. camera_info: the four stages, the recorder, the
    # locator and the demo.
    'wait_for_subscribers': 2, 'wait_for_camera_users': 7,
    # As many as the queues of images hold, and no camera far ahead of the other.
    'frames_ahead': 2, 'answer_topics': [f'/{name}/attitude_imu' for name in OBSERVERS]}

# Publishers and subscribers of each star tracker, the demo and the recorder included.
_ENDPOINTS = {
    'image_raw': (1, 2), 'odometry': (1, 4), 'truth/attitude': (1, 1), 'truth/target': (1, 2),
    'centroids': (1, 3), 'stars': (1, 2), 'tracks': (1, 2), 'tracked_attitude': (1, 2),
    'predicted_centroids': (1, 2), 'tracker_state': (1, 3), 'attitude_cov': (1, 2),
    'attitude_imu': (1, 3), 'target_centroid': (1, 2)}


def simulator_parameters(index: int, seconds: float) -> dict[str, object]:
    """
    Return the parameters of one sky_simulator.

    Its time begins with its own first frame. In the middle of the run the target is in the middle
    of the image.
    """
    offset_s = _START_OFFSETS_S[index]
    radius_m = EARTH_RADIUS_M + 1e3 * _ORBIT['altitude_km']
    angles = np.radians([_ORBIT['inclination_deg'], _ORBIT['node_deg'], _LATITUDES_DEG[index]])
    orbit = CircularOrbit(radius_m, *angles)
    target = Target(TargetOptions(target=True, **_TARGET), 2026.6)
    middle_s = seconds / 2
    position, velocity = orbit.at(middle_s)
    line = target.at(middle_s)[0] - position
    # The boresight is fixed in the orbit frame, which turns between the two times.
    boresight = orbit_frame(*orbit.at(offset_s)) @ (orbit_frame(position, velocity).T @ line)
    ra_deg, dec_deg = np.degrees(radec_from_unit(boresight))
    rate_rad_s = CircularOrbit(float(np.linalg.norm(target.at(0.0)[0])), 0.0, 0.0, 0.0).rate_rad_s
    return {
        **_COMMON, 'ra_deg': float(ra_deg), 'dec_deg': float(dec_deg),
        'latitude_deg': _LATITUDES_DEG[index] + float(np.degrees(orbit.rate_rad_s * offset_s)),
        'target_anomaly_deg': float(np.degrees(rate_rad_s * offset_s)),
        'start_time_utc': (_START + timedelta(seconds=offset_s)).isoformat()}


class TwoSatelliteDemo(Demo):
    """Two star trackers and a target_locator; compares the located target with the truth."""

    endpoints = {'target/position': (1, 2), **{
        f'{name}/{topic}': ends for name in OBSERVERS for topic, ends in _ENDPOINTS.items()}}
    needs = {
        '/bag_recorder': (),
        '/target_locator': [f'{name}/camera_info received' for name in OBSERVERS],
        **needs_of(('sky_simulator', *STAGES), OBSERVERS[0]),
        **needs_of(('sky_simulator', *STAGES), OBSERVERS[1])}
    camera_infos = tuple(f'{name}/camera_info' for name in OBSERVERS)

    def __init__(self, output: Path) -> None:
        super().__init__(output)
        self.first_position_s: float | None = None
        self._states = dict.fromkeys(OBSERVERS, 'starting')
        self._truth: dict[int, np.ndarray] = {}
        self._located: tuple[int, np.ndarray, float] | None = None
        subscribe = self.probe.create_subscription
        for name in OBSERVERS:
            subscribe(DiagnosticStatus, f'{name}/tracker_state',
                      partial(self._on_tracker_state, name), qos.STATE)
            subscribe(Odometry, f'{name}/truth/target', self._on_truth_target, qos.LIST)
        subscribe(PoseWithCovarianceStamped, 'target/position', self._on_position, qos.LIST)

    def start(self, seconds: float, frames: int, seed: int) -> None:
        """Start all nodes."""
        self.processes.start('bag_recorder', {'folder': str(self.bag)})
        self.processes.start('target_locator')
        for index, name in enumerate(OBSERVERS):
            for node in STAGES:
                self.processes.start(node, namespace=name)
            self.processes.start('sky_simulator', {
                **simulator_parameters(index, seconds), 'frame_count': frames,
                'seed': seed + index}, namespace=name)

    @property
    def frames(self) -> int:
        """Frames that both have simulated."""
        return min(map(self.simulated_frames, OBSERVERS))

    def _on_tracker_state(self, name: str, message: DiagnosticStatus) -> None:
        self._states[name] = message.message

    def _on_truth_target(self, message: Odometry) -> None:
        self._truth[ns_from_stamp(message.header.stamp)] = _xyz(message.pose.pose.position)

    def _on_position(self, message: PoseWithCovarianceStamped) -> None:
        if self.first_position_s is None:
            self.first_position_s = time.time()
        sigma_m = float(np.sqrt(np.trace(np.reshape(message.pose.covariance, (6, 6))[:3, :3])))
        self._located = (ns_from_stamp(message.header.stamp),
                         _xyz(message.pose.pose.position), sigma_m)

    def table(self, frames: int) -> Table:
        """Return the true and the located position of the target, and the progress."""
        table = Table(title='two satellites locate a third', title_justify='left', min_width=78)
        for name in ('', 'x km', 'y km', 'z km', 'error m', '1 sigma m'):
            table.add_column(name, justify='right')
        states = ', '.join(self._states.values())
        table.caption = f'frame {self.frames}/{frames}, {states}'
        if self._located is None:
            return table
        stamp_ns, position_m, sigma_m = self._located
        truth_m = self._truth.get(stamp_ns)
        error = '-'
        if truth_m is not None:
            table.add_row('true', *(f'{value / 1e3:.3f}' for value in truth_m), '', '')
            error = f'{np.linalg.norm(position_m - truth_m):.1f}'
        table.add_row('located', *(f'{value / 1e3:.3f}' for value in position_m), error,
                      f'{sigma_m:.1f}')
        return table


def _xyz(point: Point) -> np.ndarray:
    return np.array([point.x, point.y, point.z])


def run_two_satellite_demo(output: Path, *, seconds: float, seed: int) -> Result:
    """Run both pipelines and the locator; HarnessError when a node fails."""
    began_s = start_time_s()
    frames = round(seconds * FRAME_RATE_HZ)
    with TwoSatelliteDemo(output) as demo:
        demo.start(seconds, frames, seed)
        demo.watch(frames)
        demo.finish()
    recording = load_target(demo.bag, OBSERVERS)
    if demo.first_position_s is None or not len(recording.stamp_ns):
        raise HarnessError(f'the target was never located: see {demo.log_folder}')
    rows = summarise_target(recording, frames)
    rows.append(DemoRow('process start to first position', demo.first_position_s - began_s, 's'))
    picture = output / 'two_satellite.png'
    drawn = draw_if_possible(picture, lambda: draw_target(
        picture, recording, {name: _last_frame(demo.bag, name) for name in OBSERVERS}))
    return Result('demo two-satellite', rows, {
        'observers': f'{_ORBIT["altitude_km"]:g} km, {_ORBIT["inclination_deg"]:g} deg, 4 deg of '
                     'true anomaly apart; odometry with 10 m and 0.033 m/s 1 sigma per axis',
        'target': f'{_TARGET["target_altitude_km"]:g} km, {_TARGET["target_inclination_deg"]:g} '
                  'deg, with J2',
        'sky': '1024 x 1024 px, mono16 (12 bit), 12 deg field, 2 Hz, aberration and motion '
               f'smear; frames of the second camera {_START_OFFSETS_S[1]:g} s after those of the '
               'first',
        'processes': len(demo.processes.processes), 'machine': machine(str(demo.load)),
        'bag': demo.bag_text(), 'picture': drawn})


def _last_frame(bag: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return image (H, W), uv (N, 2) and hip (N,) of tracks, target (2,) of the last frame."""
    targets, tracks = {}, {}
    newest_ns = 0
    for record, stamp_ns, message in read_stamped(
            bag, (f'/{name}/target_centroid', f'/{name}/tracks')):
        if record.topic.endswith('tracks'):
            tracks[stamp_ns] = tracks_from_message(message)
        elif message.width:
            targets[stamp_ns] = centroids_from_message(message).uv[0]
            newest_ns = record.log_time_ns
    last_ns = max(targets.keys() & tracks.keys())
    image = next((image_from_message(message).pixels for _, stamp_ns, message in read_stamped(
        bag, (f'/{name}/image_raw',), newest_ns - 5 * 10 ** 9) if stamp_ns == last_ns), None)
    if image is None:
        raise HarnessError(f'{bag}: no image of the last target of {name}')
    return image, tracks[last_ns].uv, tracks[last_ns].hip, targets[last_ns]
