# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of three heads: one attitude while each is blinded in turn by Moon, Sun and Earth."""

from collections import defaultdict
from functools import partial
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
import numpy as np
from rich.table import Table
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.fusion.mounts import Mount, save_mounts
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector)
from startracker_ros.io.bags.layouts import (
    INERTIAL_FRAME_ID, ns_from_stamp, read_cloud, STAR_DTYPE)
from startracker_ros.io.table import Result
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import (
    quaternion_from_message, quaternion_to_message, tracked_attitude_from_imu)
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header, stamp_from_ns
from startracker_ros.ros.messages.odometry import motion_to_odometry
from startracker_ros.ros.processes import HarnessError
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions
from startracker_ros.tools.demos.heads_history import (
    body_motion, Forecast, HeadsHistory, MOUNTS, START_NS, TURN_S)
from startracker_ros.tools.demos.live_demo import draw_if_possible, LockStepDemo, STALL_S
from startracker_ros.tools.demos.readiness import needs_of
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import DemoRow

FRAME_RATE_HZ = 5.0
_HEADS = tuple(MOUNTS)
_BODY = 'base_link'
_FUSION_S = 60.0
EXCLUSION_DEG = {'Sun': 25.0, 'Moon': 10.0, 'Earth': 15.0}
# Their glare fills the image two degrees nearer: the last stars fade within the exclusion angle.
_GLARE_DEG = {name: angle - 2.0 for name, angle in EXCLUSION_DEG.items()}
_RATES = 4  # of the gyro from frame to frame
_GYRO_NOISE_DEG_SQRT_H = 0.01
_GYRO_NOISE = {'gyro_noise_deg_sqrt_h': _GYRO_NOISE_DEG_SQRT_H}
_BEND_RMS_ARCSEC, _SWING_K = 6.4, 10.0
_MOUNT_ERROR_ARCSEC = 5.0  # of mounts.yaml, each axis
_TIME_OFFSETS_S = {'tracker_2': 0.05}
_PARAMETERS: dict[str, object] = {
    'use_sim_time': True, 'frame_rate_hz': FRAME_RATE_HZ, 'width': 1024, 'height': 1024,
    'fov_deg': 12.0, 'bit_depth': 12, 'motion': 'topic', 'lock_step': True,
    'motion_smear': True, 'body_frame_id': _BODY, 'temperature_swing_k': _SWING_K,
    'temperature_period_s': TURN_S, 'gyro_rate_hz': 20.0, 'bright_bodies': True, **_GYRO_NOISE,
    **{f'{name.lower()}_glare_deg': angle for name, angle in _GLARE_DEG.items()},
    **{f'{name.lower()}_exclusion_deg': angle for name, angle in EXCLUSION_DEG.items()},
    # image_raw: the extractor. camera_info: the four stages, the recorder and, once all nodes are
    # ready, the demo.
    'wait_for_subscribers': 1, 'wait_for_camera_users': 6}
# What the report does not show. A subscriber of target_centroid would have the extractors search
# every image as a whole.
_NOT_RECORDED = ('*/image_raw', '*/image_annotated', '*/image_markers', '*/transition_event',
                 '*/imu', '*/truth/stars', '*/truth/artefacts', '*/centroids',
                 '*/predicted_centroids', '*/target_centroid',
                 *(f'/{name}/{topic}' for name in _HEADS for topic in (
                     'attitude', 'attitude_cov', 'attitude_transform', 'attitude_body',
                     'tracked_attitude', 'odometry', 'truth/odometry')))


class HeadsDemo(LockStepDemo):
    """
    A process for each head and one for the fusion, and the truth that all heads follow.

    It begins begin_s after START_NS.
    """

    # Within the process of a head subscriptions are not in DDS.
    endpoints = {
        'attitude_imu': (1, 1), 'attitude': (1, 2), 'heads': (1, 1), 'imu': (1, 1), **{
            f'{name}/{topic}': (1, 2) for name in _HEADS for topic in (
                'attitude_imu', 'tracker_state', 'stars', 'frame_attitude', 'hint',
                'temperature')}}
    needs = {**needs_of(('bag_recorder', 'attitude_fusion')), **{
        node: counts for name in _HEADS
        for node, counts in needs_of(('sky_simulator', *STAGES), name).items()}}
    camera_infos = tuple(f'{name}/camera_info' for name in _HEADS)

    def __init__(self, output: Path, begin_s: float = 0.0) -> None:
        super().__init__(output)
        self._begin_ns = START_NS + round(begin_s * 1e9)
        self.mounts_file = output / 'mounts.yaml'
        self._motion = body_motion()
        self._stamps_ns: list[int] = []
        self._has_attitude: dict[str, dict[int, bool]] = defaultdict(dict)
        self._identified: dict[str, set[int]] = defaultdict(set)
        self._forecasts: list[Forecast] = []
        self._states = dict.fromkeys(_HEADS, 'starting')
        self._fused: tuple[int, np.ndarray] | None = None
        publish, subscribe = self.probe.create_publisher, self.probe.create_subscription
        self._clock = publish(Clock, '/clock', qos.LIST)
        self._odometry = publish(Odometry, 'motion/odometry', qos.LIST)
        self._truth = publish(QuaternionStamped, 'truth/attitude', qos.LIST)
        self._imu = publish(Imu, 'imu', qos.IMU)
        subscribe(QuaternionStamped, 'attitude', self._on_attitude, qos.LIST)
        for name in _HEADS:
            subscribe(Imu, f'{name}/attitude_imu', partial(self._on_head, name), qos.LIST)
            subscribe(PointCloud2, f'{name}/stars', partial(self._on_stars, name), qos.LIST)
            subscribe(DiagnosticStatus, f'{name}/tracker_state', partial(self._on_state, name),
                      qos.STATE)

    def start(self, seed: int, **parameters: object) -> None:
        """Start all nodes; parameters replace those of the heads."""
        rng = np.random.default_rng(seed)
        self._gyro = Gyro(GyroOptions(gyro_noise_deg_sqrt_h=_GYRO_NOISE_DEG_SQRT_H),
                          rng=np.random.default_rng([seed, 1]))
        mounts, bends = {}, {}
        for index, (name, mount) in enumerate(MOUNTS.items()):
            # The mount of the first head defines the body.
            error, bend = rng.standard_normal((2, 3)) * bool(index)
            mounts[name] = Mount(
                multiply(quaternion_from_rotation_vector(_MOUNT_ERROR_ARCSEC * ARCSEC * error),
                         mount), time_offset_s=_TIME_OFFSETS_S.get(name, 0.0))
            size = np.sqrt(2) * _BEND_RMS_ARCSEC / _SWING_K / max(np.linalg.norm(bend), 1e-9)
            bends[name] = (size * bend).tolist()
        save_mounts(mounts, self.mounts_file)
        self.processes.start('bag_recorder', {
            'folder': str(self.bag), 'exclude': list(_NOT_RECORDED)})
        self.processes.start('attitude_fusion', {
            'use_sim_time': True, 'heads': list(_HEADS), 'mounts_file': str(self.mounts_file),
            'mount_temperature_arcsec_k': 1.0, 'body_frame_id': _BODY, **_GYRO_NOISE})
        for name, mount in MOUNTS.items():
            self.processes.start('composed_pipeline', {
                **_PARAMETERS, 'seed': seed, 'mount_quaternion': mount.tolist(),
                'bend_arcsec_k': bends[name], 'time_offset_s': _TIME_OFFSETS_S.get(name, 0.0),
                **parameters}, ('-r', 'motion/odometry:=/motion/odometry', '--', 'sky_simulator',
                                *STAGES), namespace=name)

    @property
    def frames(self) -> int:
        """Frames that were simulated."""
        return len(self._stamps_ns)

    def run(self, frames: int) -> float:
        """Simulate so many frames; return the wall time in s."""
        # The nodes learn the epoch of the sky with the camera.
        self.await_ready(
            lambda: self._clock.publish(Clock(clock=stamp_from_ns(self._begin_ns))))
        # The simulators and the recorder.
        self.probe.wait(lambda: self._odometry.get_subscription_count() >= len(_HEADS) + 1,
                        'subscribers of motion/odometry', STALL_S)
        self.probe.spin_for(0.5)
        return self.run_steps(
            lambda: self._step(self._begin_ns + round(self.frames / FRAME_RATE_HZ * 1e9)),
            lambda: self.frames >= frames, frames)

    def history(self) -> HeadsHistory:
        """Return the run of the heads."""
        stamps_ns = np.array(self._stamps_ns)
        return HeadsHistory(
            stamps_ns, self._motion, EXCLUSION_DEG,
            {name: np.array([self._has_attitude[name].get(stamp_ns, False)
                             for stamp_ns in self._stamps_ns]) for name in _HEADS},
            {name: np.isin(stamps_ns, list(self._identified[name])) for name in _HEADS},
            tuple(self._forecasts))

    def _step(self, stamp_ns: int) -> None:
        """Publish the truth of a frame, and wait for the attitudes of all heads."""
        state = self._motion.at((stamp_ns - START_NS) * 1e-9)
        header = make_header(stamp_ns, INERTIAL_FRAME_ID)
        self._stamps_ns.append(stamp_ns)
        self._clock.publish(Clock(clock=stamp_from_ns(stamp_ns)))
        self._truth.publish(quaternion_to_message(state.q_icrf_from_sensor, header))
        self._publish_rates(stamp_ns, state.rate_rad_s)
        self._odometry.publish(motion_to_odometry(
            state.position_m, state.velocity_m_s, state.q_icrf_from_sensor, state.rate_rad_s,
            header, _BODY))

        def missing() -> str:
            names = [name for name in _HEADS if stamp_ns not in self._has_attitude[name]]
            return f'{", ".join(names)} for frame {self.frames}' if names else ''
        self.await_attitudes(missing)
        # A fusion that is slow for a while would lose rates; one without an attitude is silent.
        deadline_s = time.monotonic() + _FUSION_S
        while (self._fused is not None and self._fused[0] < stamp_ns
               and time.monotonic() < deadline_s):
            self.probe.spin_once(0.05)

    def _publish_rates(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """Publish the rates of the gyro of the body up to a frame."""
        dt_s = 1 / (FRAME_RATE_HZ * _RATES)
        sigma_rad_s = np.radians(_GYRO_NOISE_DEG_SQRT_H / 60) / np.sqrt(dt_s)
        for before in range(_RATES - 1, -1, -1):
            self._imu.publish(gyro_to_imu(
                self._gyro.measure(rate_rad_s, dt_s), sigma_rad_s,
                make_header(stamp_ns - round(before * dt_s * 1e9), _BODY)))

    def _on_head(self, name: str, message: Imu) -> None:
        self._has_attitude[name][ns_from_stamp(message.header.stamp)] = (
            tracked_attitude_from_imu(message) is not None)

    def _on_stars(self, name: str, message: PointCloud2) -> None:
        if (read_cloud(message, STAR_DTYPE)['hip'] > 0).any():
            self._identified[name].add(ns_from_stamp(message.header.stamp))

    def _on_state(self, name: str, message: DiagnosticStatus) -> None:
        values = {value.key: value.value for value in message.values}
        self._states[name] = message.message
        if self._stamps_ns and 'blinding_body' in values:
            self._forecasts.append(Forecast(
                name, self._stamps_ns[-1], values['blinding_body'],
                float(values['seconds_to_blinding']), float(values['seconds_to_return'])))

    def _on_attitude(self, message: QuaternionStamped) -> None:
        self._fused = ns_from_stamp(message.header.stamp), quaternion_from_message(message)

    def table(self, frames: int) -> Table:
        """Return the states of the heads and the newest error of the fused attitude."""
        table = Table(title='heads demo', title_justify='left', min_width=78)
        for name in ('frame', *_HEADS, 'error x, y, z arcsec'):
            table.add_column(name, justify='right')
        error = '-'
        if self._fused is not None:
            stamp_ns, quaternion = self._fused
            truth = self._motion.at((stamp_ns - START_NS) * 1e-9).q_icrf_from_sensor
            error = ' '.join(f'{e:.2f}' for e in attitude_error(quaternion, truth) / ARCSEC)
        table.add_row(f'{self.frames}/{frames}', *self._states.values(), error)
        return table


def run_heads_demo(output: Path, *, seconds: float, seed: int) -> Result:
    """Run three heads and their fusion; HarnessError when a node fails."""
    frames = round(seconds * FRAME_RATE_HZ)
    with HeadsDemo(output) as demo:
        demo.start(seed)
        wall_s = demo.run(frames)
        demo.finish()
    from startracker_ros.io.recordings.loading import load_recording
    from startracker_ros.tools.report.heads import load_heads
    history, recording, heads = demo.history(), load_recording(demo.bag), load_heads(demo.bag)
    if heads is None:
        raise HarnessError(f'{demo.bag} has no heads: see {demo.log_folder}')
    pace = frames / FRAME_RATE_HZ / wall_s
    rows = [*map(DemoRow.of, history.rows(recording, heads)),
            DemoRow.with_goal('pace, simulated time over wall time', pace, '', 1.0, least=True),
            DemoRow('processor time of all processes, starts included',
                    demo.cpu_s * FRAME_RATE_HZ / frames, 's each simulated s')]
    picture, page = output / 'heads.png', output / 'report.html'
    drawn = draw_if_possible(picture, lambda: history.draw(picture, recording, heads))
    written = draw_if_possible(page, lambda: _write_report(demo.bag, page))
    return Result('demo heads', rows, {
        'heads': 'three, 90 deg apart, 1024 x 1024 px, 12 deg, 5 Hz in lock-step, smeared images; '
                 'the second one has its stamps 0.05 s late',
        'motion': f'one turn in {TURN_S:g} s about the axis between the boresights, which stands '
                  'for an orbit; 20200 km, J2000, 2026-06-09T12:00:00',
        'mounts': f'{_MOUNT_ERROR_ARCSEC:g} arcsec off in mounts.yaml, and bent by '
                  f'{_BEND_RMS_ARCSEC:g} arcsec rms with the temperature',
        'processes': len(demo.processes.processes), 'machine': machine(str(demo.load)),
        'bag': demo.bag_text(), 'picture': drawn, 'report': written})


def _write_report(bag: Path, page: Path) -> None:
    from startracker_ros.tools.report.page import write_report
    write_report(bag, page)
