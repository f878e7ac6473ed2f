# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Makes the golden bags next to this file again: python bags/make.py [FOLDER].

Simulated images run through the cores of the nodes, one frame after the other, and everything
is recorded as the nodes publish it. The same code makes the same bags.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import shutil
import sys

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_pointing, quaternion_from_rotation_vector)
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.telemetry import rate_from_imu
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.ros.diagnostics import OK, status_message
from startracker_ros.ros.messages.attitude import (
    attitude_to_imu, attitude_to_pose, quaternion_to_message, tracked_attitude_to_imu)
from startracker_ros.ros.messages.clouds import (
    centroids_from_message, centroids_to_message, identification_to_message, tracks_to_message)
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message, image_to_message
from startracker_ros.ros.messages.odometry import state_to_odometry
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import MotionState
from startracker_ros.sim.sky.simulator import SkySimulator
from std_msgs.msg import Header

CAMERA = Camera.from_fov(256, 256, 12.0)
START_NS = 1_790_000_000_000_000_000
FRAMES, STEP_NS = 60, 10 ** 8
RATES_PER_FRAME = 10
ORBIT = CircularOrbit(7.078e6, *np.radians([30.0, 40.0, 60.0]))
# Half an exposure, reading the sensor out, sending.
DELAY_NS = 65_000_000

STATE_QOS = QosProfile('keep_last', 1, durability='transient_local')
TOPICS = {'/camera_info': 'sensor_msgs/msg/CameraInfo', '/image_raw': 'sensor_msgs/msg/Image',
          '/imu': 'sensor_msgs/msg/Imu', '/odometry': 'nav_msgs/msg/Odometry',
          '/centroids': 'sensor_msgs/msg/PointCloud2',
          '/stars': 'sensor_msgs/msg/PointCloud2', '/tracks': 'sensor_msgs/msg/PointCloud2',
          '/tracked_attitude': 'sensor_msgs/msg/Imu',
          '/tracker_state': 'diagnostic_msgs/msg/DiagnosticStatus',
          '/attitude': 'geometry_msgs/msg/QuaternionStamped',
          '/attitude_cov': 'geometry_msgs/msg/PoseWithCovarianceStamped',
          '/attitude_imu': 'sensor_msgs/msg/Imu',
          '/truth/attitude': 'geometry_msgs/msg/QuaternionStamped'}


@dataclass(frozen=True)
class Turn:
    """A turn from q_start on about one axis of the sensor, by angle_rad(time_s)."""

    q_start: np.ndarray
    axis: np.ndarray
    angle_rad: Callable[[float], float]

    def at(self, time_s: float) -> MotionState:
        """Return the state at a time in s."""
        step_s = 1e-4
        rate = (self.angle_rad(time_s + step_s) - self.angle_rad(time_s - step_s)) / (2 * step_s)
        turn = quaternion_from_rotation_vector(self.axis * self.angle_rad(time_s))
        return MotionState(multiply(self.q_start, turn), self.axis * rate, *ORBIT.at(time_s))


@dataclass(frozen=True)
class Kidnapped:
    """Two attitudes, the second from a time on; no gyro can have felt the change."""

    before: Turn
    after: Turn
    time_s: float

    def at(self, time_s: float) -> MotionState:
        """Return the state at a time in s."""
        return (self.before if time_s < self.time_s else self.after).at(time_s)


def pointing(ra_deg: float, dec_deg: float, roll_deg: float) -> np.ndarray:
    return quaternion_from_pointing(*np.radians([ra_deg, dec_deg, roll_deg]))


def slewing() -> Turn:
    """Return 4 deg in 6 s, smoothly: up to 1.33 deg/s, 28 px/s."""
    length_s, angle_rad = FRAMES * STEP_NS * 1e-9, np.radians(4.0)

    def angle(time_s: float) -> float:
        share = time_s / length_s
        return angle_rad * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
    return Turn(pointing(83.0, 0.0, 20.0), np.array([0.6, 0.8, 0.0]), angle)


def steady(q_start: np.ndarray, rate_deg_s: float) -> Turn:
    return Turn(q_start, np.array([0.0, 0.6, 0.8]), lambda time_s: np.radians(rate_deg_s) * time_s)


@dataclass(frozen=True)
class Scenario:
    """A bag: the motion, the frames that are not there or dark, and those without a gyro."""

    motion: Turn | Kidnapped
    detector: DetectorOptions
    missing: tuple[int, ...] = ()
    dark: tuple[int, ...] = ()
    silent: tuple[int, ...] = ()


SHORT = DetectorOptions(exposure_s=0.04, motion_smear=True, zero_flux_e_s=5e6)
# Eight bits of as little noise as shows keep the images small.
BYTES = DetectorOptions(bit_depth=8, bias_dn=8.0, gain_e_per_dn=8.0, full_well_e=2000.0)
SCENARIOS = {
    'slew': Scenario(slewing(), SHORT),
    'kidnapped': Scenario(Kidnapped(steady(pointing(40.0, 50.0, 0.0), 0.05),
                                    steady(pointing(250.0, -30.0, 120.0), 0.05), 2.95), BYTES),
    'dropouts': Scenario(steady(pointing(150.0, 10.0, 75.0), 0.3), BYTES, missing=(15, 16, 17),
                         dark=(26, 27, 28, 29, 30, 31), silent=tuple(range(40, 50))),
}


class Recorder:
    """A bag in which each message is received a little after the one before."""

    def __init__(self, folder: Path) -> None:
        self.writer = BagWriter(folder)
        for topic, type_name in TOPICS.items():
            qos = STATE_QOS if topic == '/tracker_state' else QosProfile('keep_last', 10)
            self.writer.add_topic(topic, type_name, [qos])

    def at(self, time_ns: int) -> None:
        """Set the time of the next message."""
        self._time_ns = time_ns

    def write(self, topic: str, message: object) -> None:
        """Write a message, a tenth of a millisecond after the one before."""
        # Some messages are serialized as they are built.
        data = message if isinstance(message, bytes) else serialize_message(message)
        self.writer.write(topic, data, self._time_ns + 50_000, self._time_ns)
        self._time_ns += 100_000


def make(name: str, folder: Path) -> None:
    """Write one bag; a folder that is there already is replaced."""
    scenario = SCENARIOS[name]
    if (folder / 'metadata.yaml').exists():
        shutil.rmtree(folder)
    epoch_year = epoch_year_from_stamp(START_NS)
    sky, nothing = (SkySimulator(CAMERA, scenario.motion, stars, epoch_year,
                                 detector_options=scenario.detector, seed=len(name))
                    for stars in (load_catalog(), load_catalog().brighter_than(-10.0)))
    pipeline = StarTracker(CAMERA, epoch_year)
    recorder = Recorder(folder)
    with recorder.writer:
        for index in range(FRAMES):
            stamp_ns = START_NS + index * STEP_NS
            # As they come in: those after the middle of the exposure still before its image.
            for step in range(-3, 7):
                time_ns = index * STEP_NS + step * STEP_NS // RATES_PER_FRAME
                rate = sky.gyro(time_ns * 1e-9)
                if time_ns >= 0 and index not in scenario.silent:
                    message = gyro_to_imu(rate, 1e-4, header(START_NS + time_ns))
                    recorder.at(START_NS + time_ns)
                    recorder.write('/imu', message)
                    pipeline.add_rate(START_NS + time_ns,
                                      rate_from_imu(deserialize_message(message, Imu)))
            if index in scenario.missing:
                continue
            frame = (nothing if index in scenario.dark else sky).frame(index * STEP_NS * 1e-9)
            recorder.at(stamp_ns + DELAY_NS)
            recorder.write('/camera_info', camera_to_message(CAMERA, header(stamp_ns)))
            recorder.write('/odometry', state_to_odometry(
                frame.state.geocentric, 0.0, header(stamp_ns, 'icrf'), 'satellite'))
            pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
            recorder.write('/image_raw', image_to_message(frame.image, header(stamp_ns)))
            recorder.write('/truth/attitude', quaternion_to_message(
                frame.state.q_icrf_from_sensor, header(stamp_ns, 'icrf')))
            cloud = centroids_to_message(
                pipeline.extraction.extractor.measure(frame.image).centroids, CAMERA,
                header(stamp_ns))
            recorder.write('/centroids', cloud)
            # Through the message, which has floats of four bytes.
            centroids = centroids_from_message(deserialize_message(cloud, PointCloud2))
            write_results(recorder, stamp_ns, centroids,
                          pipeline.process_centroids(stamp_ns, centroids))


def write_results(recorder: Recorder, stamp_ns: int, centroids: Centroids,
                  frame: FrameResult) -> None:
    """Write what the nodes publish of a frame."""
    sensor, inertial = header(stamp_ns), header(stamp_ns, 'icrf')
    recorder.write('/tracked_attitude', tracked_attitude_to_imu(frame.tracked, sensor))
    recorder.write('/tracks', tracks_to_message(frame.tracks, CAMERA, sensor))
    if frame.identification is not None:
        recorder.write('/stars', identification_to_message(
            centroids, frame.identification, CAMERA, sensor))
    recorder.write('/tracker_state', status_message(
        'star_tracker: state', 'star_tracker', OK, frame.state.value, {'reason': frame.reason}))
    attitude = frame.attitude
    recorder.write('/attitude_imu', attitude_to_imu(attitude, sensor))
    if attitude is not None:
        recorder.write('/attitude', quaternion_to_message(attitude.quaternion, inertial))
        recorder.write('/attitude_cov', attitude_to_pose(attitude, inertial))


def header(stamp_ns: int, frame_id: str = 'star_tracker_optical_frame') -> Header:
    return make_header(stamp_ns, frame_id)


def main() -> None:
    """Make all bags into the folder of the command line, or next to this file."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent
    for name in SCENARIOS:
        make(name, folder / name)
        size = sum(file.stat().st_size for file in (folder / name).iterdir())
        print(f'{folder / name}: {size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
