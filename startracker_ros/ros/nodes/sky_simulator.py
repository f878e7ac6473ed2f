"""sky_simulator: nothing -> image_raw, camera_info, imu, odometry, and the truth of all."""

from dataclasses import dataclass

from geometry_msgs.msg import QuaternionStamped
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Imu, PointCloud2
from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.astro.state import State
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.options import option, Options
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.messages.attitude import quaternion_to_message
from startracker_ros.ros.messages.clouds import stars_to_message
from startracker_ros.ros.messages.gyro import gyro_to_imu
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.odometry import motion_to_odometry, state_to_odometry
from startracker_ros.ros.node import main_of
from startracker_ros.ros.source import CameraOptions, SourceNode, SourceOptions
from startracker_ros.sky.detector import DetectorOptions
from startracker_ros.sky.gyro import GyroOptions
from startracker_ros.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sky.navigation import NavigationOptions
from startracker_ros.sky.simulator import Frame, SkySimulator
from startracker_ros.sky.sources import SkyOptions
from startracker_ros.sky.target import TargetOptions
from std_msgs.msg import Header


@dataclass(frozen=True)
class SceneOptions(Options):
    """Which sky is simulated, and how many pixels see it."""

    width: int = option(1024, 'image width; a camera_file brings its own', unit='px',
                        low=16, high=4096)
    height: int = option(1024, 'image height; a camera_file brings its own', unit='px',
                         low=16, high=4096)
    faint_limit: float = option(9.0, 'faintest star that is drawn, V', unit='mag',
                                low=0.0, high=9.0)
    seed: int = option(1, 'seed of all noise: the same seed gives the same images',
                       low=0, high=2 ** 31 - 1)


class SkySimulatorNode(SourceNode):
    """Publishes images of the catalogue sky along a motion, with the truth beside them."""

    option_classes = (SourceOptions, CameraOptions, MotionOptions, SkyOptions, TargetOptions,
                      DetectorOptions, GyroOptions, NavigationOptions, SceneOptions, FrameOptions)
    task = 'simulation'

    def __init__(self) -> None:
        super().__init__('sky_simulator')
        self._imu = self.give(Imu, 'imu', qos.LIST)
        self._truth_attitude = self.give(QuaternionStamped, 'truth/attitude', qos.LIST)
        self._truth_stars = self.give(PointCloud2, 'truth/stars', qos.LIST)
        self._truth_odometry = self.give(Odometry, 'truth/odometry', qos.LIST)
        self._odometry = self.give(Odometry, 'odometry', qos.LIST)
        self._truth_target = self.give(Odometry, 'truth/target', qos.LIST)
        self._gyro_index = 0

    def configure(self) -> None:
        scene = self.options(SceneOptions)
        self._camera = self.options(CameraOptions).camera(scene.width, scene.height)
        self._simulator = SkySimulator(
            self._camera, motion_from_options(self.options(MotionOptions), seed=scene.seed),
            load_catalog().brighter_than(scene.faint_limit),
            epoch_year_from_stamp(self.start_ns()),
            sky_options=self.options(SkyOptions), detector_options=self.options(DetectorOptions),
            gyro_options=self.options(GyroOptions), target_options=self.options(TargetOptions),
            navigation_options=self.options(NavigationOptions), seed=scene.seed)
        self.start(self._camera, self._publish_frame)
        gyro = self.options(GyroOptions)
        self._gyro_sigma_rad_s = (
            np.radians(gyro.gyro_noise_deg_sqrt_h / 60) * np.sqrt(gyro.gyro_rate_hz))

    def _publish_frame(self, index: int, stamp_ns: int, time_s: float) -> None:
        frame = self._simulator.frame(time_s)
        sensor = self.sensor_header(stamp_ns)
        inertial = make_header(stamp_ns, self.options(FrameOptions).inertial_frame_id)
        self.publish_image(frame.image, self._camera, sensor)
        state = frame.state
        self._truth_attitude.publish(quaternion_to_message(
            state.q_icrf_from_sensor, inertial))
        self._truth_stars.publish(self._stars_message(frame, sensor))
        self._truth_odometry.publish(motion_to_odometry(
            state.position_m, state.velocity_m_s, state.q_icrf_from_sensor, state.rate_rad_s,
            inertial, sensor.frame_id))
        self._publish_orbits(time_s, inertial)
        self._publish_gyro(stamp_ns, time_s, sensor.frame_id)
        self.diagnostics.values['stars'] = np.count_nonzero(frame.stars.hip)
        self.diagnostics.report(OK, 'simulating the sky')

    def _publish_orbits(self, time_s: float, header: Header) -> None:
        """Publish what the navigation knows, and where the target is when there is one."""
        options = self.options(NavigationOptions)
        self._odometry.publish(state_to_odometry(
            State(*self._simulator.navigation(time_s),
                  np.eye(3) * options.position_sigma_m ** 2),
            options.velocity_sigma_m_s ** 2, header))
        if self._simulator.target is not None:
            self._truth_target.publish(state_to_odometry(
                State(*self._simulator.target.at(time_s), np.zeros((3, 3))), 0.0, header))

    def _publish_gyro(self, stamp_ns: int, time_s: float, frame_id: str) -> None:
        """Publish the gyro measurements that are due up to the time of a frame."""
        rate_hz = self.options(GyroOptions).gyro_rate_hz
        due = int(time_s * rate_hz + 1e-6)
        # After a pause, only what a gyro would have given within one second.
        first = max(self._gyro_index + 1, due - int(rate_hz))
        for index in range(first, due + 1):
            header = make_header(
                stamp_ns + round((index / rate_hz - time_s) * 1e9), frame_id)
            self._imu.publish(gyro_to_imu(
                self._simulator.gyro(index / rate_hz), self._gyro_sigma_rad_s, header))
        self._gyro_index = due

    def _stars_message(self, frame: Frame, header: Header) -> PointCloud2:
        unknown = np.full(len(frame.stars), np.nan)
        exact = Centroids(uv=frame.stars.uv, flux=frame.flux_dn, snr=unknown,
                          sigma_px=np.zeros(len(unknown)))
        return stars_to_message(exact, frame.stars.hip, frame.stars.magnitude,
                                np.zeros(len(unknown)), self._camera, header)


main = main_of(SkySimulatorNode)

if __name__ == '__main__':
    main()
