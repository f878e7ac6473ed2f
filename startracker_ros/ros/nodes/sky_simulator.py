"""sky_simulator: nothing -> image_raw, camera_info, imu, odometry, and the truth of all."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from startracker_ros.astro.epoch import epoch_year_from_stamp
from startracker_ros.catalog.band import BandOptions
from startracker_ros.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.options import option, Options
from startracker_ros.ros.diagnostics import OK
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.image_topic import TransportOptions
from startracker_ros.ros.managed import StartError
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.motion_input import MotionInput, MotionInputOptions
from startracker_ros.ros.node import main_of
from startracker_ros.ros.simulator_output import GyroOutput, NavigationOutput, TruthOutput
from startracker_ros.ros.source import CameraOptions, SourceNode, SourceOptions
from startracker_ros.sky.artefacts import ArtefactOptions
from startracker_ros.sky.detector import DetectorOptions
from startracker_ros.sky.gyro import GyroOptions
from startracker_ros.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sky.motion_state import Motion
from startracker_ros.sky.navigation import NavigationOptions
from startracker_ros.sky.presets import PRESETS, with_preset
from startracker_ros.sky.simulator import SkySimulator
from startracker_ros.sky.sources import SkyOptions
from startracker_ros.sky.target import TargetOptions


@dataclass(frozen=True)
class SceneOptions(Options):
    """Which sky is simulated, and how many pixels see it."""

    width: int = option(1024, 'image width; a camera_file brings its own', unit='px',
                        low=16, high=4096)
    height: int = option(1024, 'image height; a camera_file brings its own', unit='px',
                         low=16, high=4096)
    faint_limit: float = option(
        9.0, 'faintest star that is drawn, V; beyond 9 only fields below 4 deg have stars',
        unit='mag', low=0.0, high=DEEP_LIMIT)
    seed: int = option(1, 'seed of all noise: the same seed gives the same images',
                       low=0, high=2 ** 31 - 1)
    preset: str = option(
        'none', 'harsh: a bad day of a worn sensor; its values replace those of the parameters '
        'that are at their defaults', choices=tuple(PRESETS))


class SkySimulatorNode(SourceNode):
    """Publishes images of the catalogue sky along a motion, with the truth beside them."""

    option_classes = (SourceOptions, CameraOptions, MotionOptions, SkyOptions, TargetOptions,
                      DetectorOptions, ArtefactOptions, GyroOptions, NavigationOptions,
                      SceneOptions, MotionInputOptions, FrameOptions, TransportOptions,
                      BandOptions)
    task = 'simulation'

    def __init__(self) -> None:
        super().__init__('sky_simulator')
        self._truth = TruthOutput(self)
        self._navigation = NavigationOutput(self)
        self._gyro = GyroOutput(self)
        self._motion = MotionInput(self, self._begin, self._publish_frame)

    def rebuild(self) -> None:
        scene, motion = self.options(SceneOptions), self.options(MotionOptions)
        self._camera = self.options(CameraOptions).camera(scene.width, scene.height)
        if motion.motion == 'topic':
            if self.options(SkyOptions).satellites:
                raise StartError('satellites need a motion that is known in advance: not topic')
            detector = with_preset(self.options(DetectorOptions), scene.preset)
            self.stop()
            self._motion.rebuild(partial(self.has_users, self._camera), (
                detector.exposure_s + 1e-6 * detector.line_time_us * self._camera.height) / 2)
            return
        self._motion.rebuild(None, 0.0)
        self._build(motion_from_options(motion, seed=scene.seed), self.start_ns())
        self.start(self._camera, self._publish_frame)

    def _begin(self, stamp_ns: int) -> None:
        self._build(self._motion.motion, stamp_ns)

    def _build(self, motion: Motion, start_ns: int) -> None:
        scene = self.options(SceneOptions)
        self._simulator = SkySimulator(
            self._camera, motion,
            camera_catalog(self._camera, band=self.options(BandOptions)).brighter_than(
                scene.faint_limit),
            epoch_year_from_stamp(start_ns),
            sky_options=self.options(SkyOptions),
            detector_options=with_preset(self.options(DetectorOptions), scene.preset),
            artefact_options=with_preset(self.options(ArtefactOptions), scene.preset),
            gyro_options=self.options(GyroOptions), target_options=self.options(TargetOptions),
            navigation_options=self.options(NavigationOptions),
            frame_rate_hz=self.options(SourceOptions).frame_rate_hz, seed=scene.seed)

    def _publish_frame(self, index: int, stamp_ns: int, time_s: float) -> None:
        simulator = self._simulator
        frame = simulator.frame(time_s)
        sensor = self.sensor_header(stamp_ns)
        inertial = make_header(stamp_ns, self.options(FrameOptions).inertial_frame_id)
        self.publish_image(frame.image, self._camera, sensor)
        self._truth.publish(frame, self._camera, inertial, sensor)
        self._navigation.publish(
            *simulator.navigation(time_s), self.options(NavigationOptions), inertial)
        if simulator.target is not None:
            self._truth.publish_target(*simulator.target.at(time_s), inertial)
        self._gyro.publish(
            simulator, self.options(GyroOptions), stamp_ns, time_s, sensor.frame_id)
        self.diagnostics.values['stars'] = np.count_nonzero(frame.stars.hip)
        self.diagnostics.report(OK, 'simulating the sky')


main = main_of(SkySimulatorNode)

if __name__ == '__main__':
    main()
