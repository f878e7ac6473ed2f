# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated instrument of sky_simulator, and what it publishes in addition to its images."""

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2, Temperature
from startracker_ros.core.astro.epoch import catalogue_epoch
from startracker_ros.core.astro.state import State
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, status_message
from startracker_ros.ros.messages.attitude import quaternion_to_message
from startracker_ros.ros.messages.clouds import stars_to_message
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.odometry import motion_to_odometry, state_to_odometry
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.source import SourceOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import SceneOptions, simulator_parts, with_preset
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.motion_state import Motion
from startracker_ros.sim.sky.mounted import HeadOptions, mounted, seed_in_namespace
from startracker_ros.sim.sky.sensors import GyroOptions, NavigationOptions
from startracker_ros.sim.sky.simulator import Frame, SkySimulator
from std_msgs.msg import Header


class TruthOutput:
    """Publishes the true attitude, stars, motion and artefacts of each frame."""

    def __init__(self, node: PipelineNode) -> None:
        self._hardware_id = node.hardware_id
        self._artefacts = node.advertise(DiagnosticArray, 'truth/artefacts', qos.LIST)
        self._attitude = node.advertise(QuaternionStamped, 'truth/attitude', qos.LIST)
        self._stars = node.advertise(PointCloud2, 'truth/stars', qos.LIST)
        self._odometry = node.advertise(Odometry, 'truth/odometry', qos.LIST)
        self._target = node.advertise(Odometry, 'truth/target', qos.LIST)

    def publish(self, frame: Frame, camera: Camera, inertial: Header, sensor: Header) -> None:
        """Publish the truth of a frame, with headers in the inertial and the sensor frame."""
        state = frame.state
        self._attitude.publish(quaternion_to_message(state.q_icrf_from_sensor, inertial))
        self._stars.publish(_stars_message(frame, camera, sensor))
        self._odometry.publish(motion_to_odometry(
            state.position_m, state.velocity_m_s, state.q_icrf_from_sensor, state.rate_rad_s,
            inertial, sensor.frame_id))
        counts = frame.artefacts.counts()
        if any(counts.values()):
            self._artefacts.publish(DiagnosticArray(header=sensor, status=[status_message(
                'sky_simulator: artefacts', self._hardware_id, OK, 'artefacts in the image',
                dict(counts))]))

    def publish_target(self, position_m: np.ndarray, velocity_m_s: np.ndarray, header: Header
                       ) -> None:
        """Publish the true state of the target."""
        state = State(position_m, velocity_m_s, np.zeros((3, 3)))
        self._target.publish(state_to_odometry(state, 0.0, header, 'target'))


class NavigationOutput:
    """Publishes the position and velocity that the navigation of the satellite measures."""

    def __init__(self, node: PipelineNode) -> None:
        self._odometry = node.advertise(Odometry, 'odometry', qos.LIST)

    def publish(self, position_m: np.ndarray, velocity_m_s: np.ndarray,
                options: NavigationOptions, header: Header) -> None:
        """Publish one measurement with its covariance."""
        state = State(position_m, velocity_m_s, np.eye(3) * options.position_sigma_m ** 2)
        self._odometry.publish(state_to_odometry(
            state, options.velocity_sigma_m_s ** 2, header, options.satellite_frame_id))


class TemperatureOutput:
    """Publishes the temperature of the head."""

    def __init__(self, node: PipelineNode) -> None:
        self._temperature = node.advertise(Temperature, 'temperature', qos.LIST)

    def publish(self, celsius: float, header: Header) -> None:
        """Publish the temperature at the stamp of a frame."""
        self._temperature.publish(Temperature(header=header, temperature=celsius))


class GyroOutput:
    """Publishes the measurements of the gyro, at its own rate."""

    def __init__(self, node: PipelineNode) -> None:
        self._imu = node.advertise(Imu, 'imu', qos.IMU)
        self._index = 0

    def publish(self, simulator: SkySimulator, options: GyroOptions, stamp_ns: int,
                time_s: float, frame_id: str) -> None:
        """Publish the measurements since the last frame, up to a frame at stamp_ns, time_s."""
        rate_hz = options.gyro_rate_hz
        sigma_rad_s = np.radians(options.gyro_noise_deg_sqrt_h / 60) * np.sqrt(rate_hz)
        newest = int(time_s * rate_hz + 1e-6)
        # After a pause, no more measurements than a subscriber holds.
        for index in range(max(self._index, newest - qos.IMU.depth) + 1, newest + 1):
            header = make_header(stamp_ns + round((index / rate_hz - time_s) * 1e9), frame_id)
            self._imu.publish(gyro_to_imu(simulator.gyro(index / rate_hz), sigma_rad_s, header))
        self._index = newest


def _stars_message(frame: Frame, camera: Camera, header: Header) -> bytes:
    count = len(frame.stars)
    exact = Centroids(uv=frame.stars.uv, flux=frame.flux_dn, snr=np.full(count, np.nan),
                      sigma_px=np.zeros(count))
    return stars_to_message(exact, frame.stars.hip, frame.stars.magnitude, np.zeros(count),
                            camera, header)


def detector_options(node: PipelineNode) -> DetectorOptions:
    """Return the options of the detector, with the preset."""
    return with_preset(node.options(DetectorOptions), node.options(SceneOptions).preset)


def make_simulator(node: PipelineNode, camera: Camera, start_ns: int,
                   body: Motion | None = None) -> SkySimulator:
    """
    Return the simulator of a node from a stamp on, along the motion of a body or its own.

    Heads in different namespaces have seeds of their own.
    """
    head = node.options(HeadOptions)
    seed = seed_in_namespace(node.options(SceneOptions).seed, node.get_namespace())
    motion = (motion_from_options(node.options(MotionOptions), seed=seed, head=head)
              if body is None else mounted(body, head))
    return SkySimulator(camera, motion, epoch_year=catalogue_epoch(start_ns).year,
                        frame_rate_hz=node.options(SourceOptions).frame_rate_hz, seed=seed,
                        **simulator_parts(node.options, camera))
