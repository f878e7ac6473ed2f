# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sky_simulator: nothing -> image_raw, camera_info, imu, odometry, and the truth of all."""

from functools import partial

import numpy as np
from startracker_ros.ros.diagnostics import OK
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.image_topic import TransportOptions
from startracker_ros.ros.managed import StartError
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.motion_input import MotionInput, MotionInputOptions
from startracker_ros.ros.node import main_of
from startracker_ros.ros.simulator_output import (
    detector_options, GyroOutput, make_simulator, NavigationOutput, TemperatureOutput, TruthOutput)
from startracker_ros.ros.source import CameraOptions, SourceNode, SourceOptions
from startracker_ros.sim.sky.from_options import SceneOptions, SKY_OPTIONS
from startracker_ros.sim.sky.motion import MotionOptions
from startracker_ros.sim.sky.motion_state import Motion
from startracker_ros.sim.sky.mounted import HeadOptions
from startracker_ros.sim.sky.sensors import GyroOptions, NavigationOptions
from startracker_ros.sim.sky.sources import SkyOptions

# No star of the catalogue moves by more than 0.2 arcsec in this time.
_EPOCH_TOLERANCE_NS = 18 * 86400 * 10 ** 9


class SkySimulatorNode(SourceNode):
    """Publishes images of the catalogue sky along a motion, with the truth next to them."""

    option_classes = (SourceOptions, CameraOptions, *SKY_OPTIONS, MotionInputOptions, FrameOptions,
                      TransportOptions)
    task = 'simulation'

    def __init__(self) -> None:
        super().__init__('sky_simulator')
        self._truth = TruthOutput(self)
        self._navigation = NavigationOutput(self)
        self._gyro = GyroOutput(self)
        self._temperature = TemperatureOutput(self)
        self._motion = MotionInput(self, self._begin, self._publish_frame)

    def rebuild(self) -> None:
        scene = self.options(SceneOptions)
        self._camera = self.options(CameraOptions).camera(scene.width, scene.height)
        if self.options(MotionOptions).motion == 'topic':
            if self.options(SkyOptions).satellites:
                raise StartError('satellites need a motion that is known in advance: not topic')
            detector = detector_options(self)
            self.stop()
            self._motion.rebuild(partial(self.has_users, self._camera), (
                detector.exposure_s + 1e-6 * detector.line_time_us * self._camera.height) / 2)
            return
        self._motion.rebuild(None, 0.0)
        self._build(None, self.start_ns())
        self.start(self._camera, self._publish_frame)

    def before_first_image(self, stamp_ns: int) -> None:
        # With simulated time the node may be configured before it receives /clock.
        body, start_ns = self._built
        if abs(stamp_ns - start_ns) > _EPOCH_TOLERANCE_NS:
            self._build(body, stamp_ns)

    def _begin(self, stamp_ns: int) -> None:
        self._build(self._motion.motion, stamp_ns)

    def _build(self, body: Motion | None, start_ns: int) -> None:
        self._built = body, start_ns
        self._simulator = make_simulator(self, self._camera, start_ns, body)

    def _publish_frame(self, index: int, stamp_ns: int, time_s: float) -> None:
        simulator = self._simulator
        frame = simulator.frame(time_s)
        sensor = self.sensor_header(stamp_ns)
        inertial = make_header(stamp_ns, self.options(FrameOptions).inertial_frame_id)
        self._truth.publish(frame, self._camera, inertial, sensor)
        self._navigation.publish(
            *simulator.navigation(time_s), self.options(NavigationOptions), inertial)
        if simulator.target is not None:
            self._truth.publish_target(*simulator.target.at(time_s), inertial)
        self._gyro.publish(
            simulator, self.options(GyroOptions), stamp_ns, time_s, sensor.frame_id)
        self._temperature.publish(self.options(HeadOptions).temperature_at(time_s), sensor)
        # Last: what follows on an image shares no processor with the rest of its frame, and a
        # tracker has the gyro of it.
        self.publish_image(frame.image, self._camera, sensor)
        self.diagnostics.values['stars'] = np.count_nonzero(frame.stars.hip)
        self.diagnostics.report(OK, 'simulating the sky')


main = main_of(SkySimulatorNode)

if __name__ == '__main__':
    main()
