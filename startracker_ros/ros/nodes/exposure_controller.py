# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""exposure_controller: image_raw of another driver -> its exposure and gain, exposure_start."""

from sensor_msgs.msg import TimeReference
from startracker_ros.core.exposure.control import ExposureOptions
from startracker_ros.io.bags.layouts import ns_from_stamp, StarImage
from startracker_ros.io.images.auto_exposure import AutoExposure
from startracker_ros.io.images.capture import Captured
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.driver_settings import DriverOptions, DriverSettings
from startracker_ros.ros.image_topic import subscribe_images, TransportOptions
from startracker_ros.ros.messages.image import exposure_to_message
from startracker_ros.ros.node import main_of, PipelineNode
from std_msgs.msg import Header


class ExposureControllerNode(PipelineNode):
    """Chooses exposure time and gain of a camera driver by the stars, as camera_source does."""

    option_classes = (DriverOptions, ExposureOptions, TransportOptions)
    task = 'exposure'

    def __init__(self) -> None:
        super().__init__('exposure_controller')
        self._exposure: AutoExposure | None = None
        self._exposure_start = self.advertise(TimeReference, 'exposure_start', qos.LIST)
        self._driver = DriverSettings(self, self.options(DriverOptions))
        subscribe_images(self, self._on_image)

    def rebuild(self) -> None:
        if self._exposure is not None:
            self.deactivate()
            self.activate()

    def activate(self) -> None:
        self._driver.forget()
        self._exposure = AutoExposure(self.options(ExposureOptions), self._driver, 0.0)

    def deactivate(self) -> None:
        if self._exposure is not None:
            self._exposure.close()
        self._exposure = None
        self.diagnostics.values.clear()

    def close(self) -> None:
        self.deactivate()

    def _on_image(self, image: StarImage, header: Header) -> None:
        assert self._exposure is not None
        stamp_ns = ns_from_stamp(header.stamp)
        setting = self._driver.of_image(stamp_ns)
        if setting is not None:
            self._exposure_start.publish(exposure_to_message(setting.exposure_ms / 1e3, header))
            self._exposure.offer(Captured(image.pixels, stamp_ns, 'driver', 0.0, setting))
            self.diagnostics.values.update(self._exposure.values())
            self.diagnostics.values.update({'exposure_ms': f'{setting.exposure_ms:.4g}',
                                            'gain': f'{setting.gain:.4g}'})
        problem = self._driver.problem
        self.diagnostics.report(WARN if problem else OK, problem or 'choosing by the stars')


main = main_of(ExposureControllerNode)

if __name__ == '__main__':
    main()
