"""The demo of two satellites that locate a third: twelve processes, recorded and summarised."""

from datetime import datetime, timedelta, UTC
from functools import partial
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.serialization import deserialize_message
from rich.table import Table
from sensor_msgs.msg import CameraInfo
from startracker_ros.astro.constants import EARTH_RADIUS_M
from startracker_ros.astro.orbit import CircularOrbit, orbit_frame
from startracker_ros.bag.layouts import image_from_message, ns_from_stamp
from startracker_ros.bag.reader import read_messages
from startracker_ros.figures.rows import Row
from startracker_ros.harness.demo import (
    begin_s, DemoError, draw_if_possible, end, Monitor, prepare, watch)
from startracker_ros.harness.processes import NodeProcesses
from startracker_ros.maths.rotation import radec_from_unit
from startracker_ros.report.target import draw_target, load_target, summarise_target
from startracker_ros.ros import qos
from startracker_ros.ros.messages.clouds import centroids_from_message, tracks_from_message
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.sky.target import Target, TargetOptions
from startracker_ros.table import Result

FRAME_RATE_HZ = 2.0
OBSERVERS = ('tracker_1', 'tracker_2')

# The second camera opens its shutter between two frames of the first.
_LATER_S = (0.0, 0.2)
_START = datetime(2026, 8, 25, 18, tzinfo=UTC)
_ORBIT = {'altitude_km': 700.0, 'inclination_deg': 30.0, 'node_deg': 40.0}
_LATITUDES_DEG = (-2.0, 2.0)
_TARGET = {'target_altitude_km': 1090.0, 'target_inclination_deg': 33.0, 'target_node_deg': 40.0,
           'target_magnitude': 5.0}
_ALIKE = {
    'frame_rate_hz': FRAME_RATE_HZ, 'width': 1024, 'height': 1024, 'fov_deg': 12.0,
    'bit_depth': 12, 'aberration': True, 'motion': 'low_earth_orbit', 'motion_smear': True,
    'target': True, **_ORBIT, **_TARGET,
    # The recorder and the extractor; the four stages, the recorder, the locator, the monitor.
    'wait_for_subscribers': 2, 'wait_for_camera_users': 7}
_PIPELINE = ('centroid_extractor', 'star_identifier', 'star_tracker', 'attitude_estimator')

# How many publishers and subscribers (monitor and recorder among them) complete it.
_ENDPOINTS = {'centroids': (1, 3), 'stars': (1, 2), 'tracks': (1, 2), 'tracked_attitude': (1, 2),
              'tracker_state': (1, 3), 'attitude_cov': (1, 2), 'target_centroid': (1, 2)}


def simulator_parameters(index: int, seconds: float) -> dict[str, object]:
    """
    Return what one sky_simulator is told.

    Time 0 is that of its own first frame; the target stands in the middle of the image in the
    middle of the run.
    """
    later_s = _LATER_S[index]
    radius_m = EARTH_RADIUS_M + 1e3 * _ORBIT['altitude_km']
    angles = np.radians([_ORBIT['inclination_deg'], _ORBIT['node_deg'], _LATITUDES_DEG[index]])
    orbit = CircularOrbit(radius_m, *angles)
    target = Target(TargetOptions(target=True, **_TARGET), 2026.6)
    middle_s = seconds / 2
    place, velocity = orbit.at(middle_s)
    line = target.at(middle_s)[0] - place
    # Fixed in the orbit frame, so turned with it to where it is at the first frame.
    boresight = orbit_frame(*orbit.at(later_s)) @ (orbit_frame(place, velocity).T @ line)
    ra_deg, dec_deg = np.degrees(radec_from_unit(boresight))
    turn_rad_s = CircularOrbit(float(np.linalg.norm(target.at(0.0)[0])), 0.0, 0.0, 0.0).rate_rad_s
    return {
        **_ALIKE, 'ra_deg': float(ra_deg), 'dec_deg': float(dec_deg),
        'latitude_deg': _LATITUDES_DEG[index] + float(np.degrees(orbit.rate_rad_s * later_s)),
        'target_anomaly_deg': float(np.degrees(turn_rad_s * later_s)),
        'start_time_utc': (_START + timedelta(seconds=later_s)).isoformat()}


class _Monitor(Monitor):
    """Compares the located target with the truth, as far as it has come."""

    def __init__(self) -> None:
        super().__init__('demo_monitor')
        self._frames = dict.fromkeys(OBSERVERS, 0)
        self._states = dict.fromkeys(OBSERVERS, 'starting')
        self._released = False
        self._truth: dict[int, np.ndarray] = {}
        self._located: tuple[int, np.ndarray, float] | None = None
        self.first_position_s: float | None = None
        self.create_subscription(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)
        for name in OBSERVERS:
            self.create_subscription(DiagnosticStatus, f'{name}/tracker_state',
                                     partial(self._take_state, name), qos.STATE)
            self.create_subscription(Odometry, f'{name}/truth/target', self._take_truth, qos.LIST)
        self.create_subscription(PoseWithCovarianceStamped, 'target/position',
                                 self._take_position, qos.LIST)

    @property
    def frames(self) -> int:
        """Frames of the slower of both."""
        return min(self._frames.values())

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'sky_simulator: simulation':
                values = {value.key: value.value for value in status.values}
                self._frames[status.hardware_id] = int(values.get('frames', 0))

    def _take_state(self, name: str, message: DiagnosticStatus) -> None:
        self._states[name] = message.message

    def _take_truth(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._truth[ns_from_stamp(message.header.stamp)] = np.array([place.x, place.y, place.z])

    def _take_position(self, message: PoseWithCovarianceStamped) -> None:
        if self.first_position_s is None:
            self.first_position_s = time.time()
        place = message.pose.pose.position
        sigma_m = float(np.sqrt(np.trace(np.reshape(message.pose.covariance, (6, 6))[:3, :3])))
        self._located = (ns_from_stamp(message.header.stamp),
                         np.array([place.x, place.y, place.z]), sigma_m)

    def release_when_complete(self) -> None:
        """Let both simulators begin, by listening to camera_info, once all are connected."""
        topics = [('target/position', 1, 2)] + [
            (f'{name}/{topic}', *ends) for name in OBSERVERS for topic, ends in _ENDPOINTS.items()]
        if not self._released and all(
                self.count_publishers(topic) >= publishers
                and self.count_subscribers(topic) >= subscribers
                for topic, publishers, subscribers in topics):
            self._released = True
            for name in OBSERVERS:
                self.create_subscription(CameraInfo, f'{name}/camera_info',
                                         lambda message: None, qos.LIST)

    def table(self, frames: int) -> Table:
        """Return where the target is, where it was located, and the progress."""
        table = Table(title='two satellites locate a third', title_justify='left', min_width=78)
        for name in ('', 'x km', 'y km', 'z km', 'error m', '1 sigma m'):
            table.add_column(name, justify='right')
        states = ', '.join(self._states.values())
        table.caption = f'frame {self.frames}/{frames}, {states}'
        if self._located is None:
            return table
        stamp_ns, place, sigma_m = self._located
        truth = self._truth.get(stamp_ns)
        error = '-'
        if truth is not None:
            table.add_row('true', *(f'{value / 1e3:.3f}' for value in truth), '', '')
            error = f'{np.linalg.norm(place - truth):.1f}'
        table.add_row('located', *(f'{value / 1e3:.3f}' for value in place), error,
                      f'{sigma_m:.1f}')
        return table


def run_two_satellite_demo(output: Path, *, seconds: float, seed: int) -> Result:
    """Run both pipelines and the locator; DemoError when a node fails."""
    started_s = begin_s()
    frames = round(seconds * FRAME_RATE_HZ)
    logs, bag = prepare(output), output / 'bag'
    with NodeProcesses(logs) as nodes:
        nodes.start('bag_recorder', {'folder': str(bag)})
        nodes.start('target_locator')
        for index, name in enumerate(OBSERVERS):
            for node in _PIPELINE:
                nodes.start(node, namespace=name)
            nodes.start('sky_simulator', {
                **simulator_parameters(index, seconds), 'frame_count': frames,
                'seed': seed + index}, namespace=name)
        rclpy.init()
        monitor = _Monitor()
        try:
            # Twelve processes take their time to find each other on a busy machine.
            watch(monitor, nodes, frames, patience_s=90.0)
        finally:
            monitor.destroy_node()
            rclpy.try_shutdown()
        end(nodes)
    recording = load_target(bag, OBSERVERS)
    if monitor.first_position_s is None or not len(recording.stamp_ns):
        raise DemoError(f'the target was never located: see {logs}')
    rows = summarise_target(recording, frames)
    rows.append(Row('process start to first position', monitor.first_position_s - started_s, 's'))
    picture = output / 'two_satellite.png'
    drawn = draw_if_possible(picture, lambda: draw_target(
        picture, recording, {name: _last_frame(bag, name) for name in OBSERVERS}))
    size_mb = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
    return Result('demo two-satellite', rows, {
        'observers': f'{_ORBIT["altitude_km"]:g} km, {_ORBIT["inclination_deg"]:g} deg, 4 deg of '
                     'true anomaly apart; odometry with 10 m and 0.033 m/s 1 sigma per axis',
        'target': f'{_TARGET["target_altitude_km"]:g} km, {_TARGET["target_inclination_deg"]:g} '
                  'deg, with J2',
        'sky': '1024 x 1024 px, mono16 (12 bit), 12 deg field, 2 Hz, aberration and motion '
               f'smear; frames of the second camera {_LATER_S[1]:g} s after those of the first',
        'processes': len(nodes.processes),
        'bag': f'{bag} ({size_mb:.0f} MB)', 'picture': drawn})


def _last_frame(bag: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return image (H, W), uv (N, 2) and hip (N,) of tracks, target (2,) of the last frame."""
    targets, tracks, image = {}, {}, None
    topics = (f'/{name}/target_centroid', f'/{name}/tracks', f'/{name}/image_raw')
    newest_ns = 0
    for record in read_messages(bag, topics=topics[:2]):
        message = deserialize_message(record.data, message_class(record.type_name))
        stamp_ns = ns_from_stamp(message.header.stamp)
        if record.topic == topics[1]:
            tracks[stamp_ns] = tracks_from_message(message)
        elif message.width:
            targets[stamp_ns] = centroids_from_message(message).uv[0]
            newest_ns = record.log_time_ns
    last_ns = max(targets.keys() & tracks.keys())
    for record in read_messages(bag, topics=topics[2:], start_ns=newest_ns - 5 * 10 ** 9):
        message = deserialize_message(record.data, message_class(record.type_name))
        if ns_from_stamp(message.header.stamp) == last_ns:
            image = image_from_message(message)
    if image is None:
        raise DemoError(f'{bag}: no image of the last target of {name}')
    return image, tracks[last_ns].uv, tracks[last_ns].hip, targets[last_ns]
