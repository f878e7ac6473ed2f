# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""camera_source: a camera of Video4Linux, or files in its place -> images, exposures."""

from sensor_msgs.msg import TimeReference
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.exposure.control import ExposureMode, ExposureOptions
from startracker_ros.io.images.auto_exposure import AutoExposure
from startracker_ros.io.images.capture import (
    Captured, CaptureOptions, CaptureThread, CAPTURING, ENDED, FAILED, LOST, OPENING)
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import ERROR, OK, WARN
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.image_topic import TransportOptions
from startracker_ros.ros.messages.image import exposure_to_message
from startracker_ros.ros.node import main_of
from startracker_ros.ros.source import CameraOptions, ImageSourceNode

_LEVELS = {OPENING: WARN, CAPTURING: OK, ENDED: OK, LOST: ERROR, FAILED: ERROR}


class CameraSourceNode(ImageSourceNode):
    """
    Publishes each image of a camera when it arrives, stamped with the middle of its exposure.

    The device is open while the node is active.
    """

    option_classes = (CaptureOptions, ExposureMode, ExposureOptions, CameraOptions, FrameOptions,
                      TransportOptions)
    task = 'camera'

    def __init__(self) -> None:
        super().__init__('camera_source')
        self._capture: CaptureThread | None = None
        self._exposure: AutoExposure | None = None
        self._exposure_start = self.advertise(TimeReference, 'exposure_start', qos.LIST)
        self._camera: Camera | None = None
        self._mismatch = ''
        self.diagnostics.checks.append(self._check)

    def rebuild(self) -> None:
        self._camera, self._mismatch = None, ''
        # A bad camera file stops the node here, where the user looks.
        self.options(CameraOptions).file_camera()
        if self._capture is not None:
            self.deactivate()
            self.activate()

    def activate(self) -> None:
        capture = self.options(CaptureOptions)
        self._capture = CaptureThread(capture, self._wake)
        if self.options(ExposureMode).exposure == 'auto':
            self._exposure = AutoExposure(
                self.options(ExposureOptions), self._capture, capture.exposure_ms)
        self._capture.start()

    def deactivate(self) -> None:
        if self._capture is not None:
            self._capture.stop()
        if self._exposure is not None:
            self._exposure.close()
        self._capture = self._exposure = None
        # Of images with other settings.
        self.diagnostics.values.clear()

    def close(self) -> None:
        self.deactivate()

    def _wake(self) -> None:
        """Publish in the thread of the node; called in that of the capture."""
        if self.executor is not None:
            self.executor.create_task(self._publish)

    def _publish(self) -> None:
        capture = self._capture
        captured = None if capture is None else capture.newest()
        if captured is None or not self.active:
            return
        height, width = captured.image.shape
        if self._camera is None:
            self._camera = self.options(CameraOptions).camera(width, height)
        camera = self._camera
        if (camera.width, camera.height) != (width, height):
            self.diagnostics.counts['images of another size'] += 1
            self._mismatch = (f'images of {width} x {height} px, camera_file has {camera.width} x '
                              f'{camera.height}: set width and height, or calibrate at this size')
            return
        self._mismatch = ''
        header = self.sensor_header(captured.stamp_ns)
        if captured.setting is not None:
            self._exposure_start.publish(
                exposure_to_message(captured.setting.exposure_ms / 1e3, header))
        self.publish_image(captured.image, camera, header)
        if self._exposure is not None:
            self._exposure.offer(captured)
        self._report(captured)

    def _report(self, captured: Captured) -> None:
        self.diagnostics.values.update({
            'size': f'{captured.image.shape[1]} x {captured.image.shape[0]}, '
                    f'{8 * captured.image.itemsize} bit',
            'stamp_from': captured.stamp_from,
            'stamp_error_ms': f'{1e3 * captured.stamp_error_s:.1f}'})
        if captured.setting is not None:
            self.diagnostics.values.update({
                'exposure_ms': f'{captured.setting.exposure_ms:.4g}',
                'gain': f'{captured.setting.gain:.4g}'})
        if self._exposure is not None:
            self.diagnostics.values.update(self._exposure.values())

    def _check(self) -> None:
        """Report the state of the device."""
        capture = self._capture
        if capture is None:
            return
        self.diagnostics.values.update(dropped=capture.dropped, losses=capture.losses)
        level, text = _LEVELS[capture.state.name], capture.state.text
        if level == OK and self._mismatch:
            level, text = ERROR, self._mismatch
        elif level == OK and capture.problems:
            level, text = WARN, f'{text}: {"; ".join(capture.problems)}'
        self.diagnostics.report(level, text)


main = main_of(CameraSourceNode)

if __name__ == '__main__':
    main()
