# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""camera_calibrator: stars or tracks, camera_info -> a camera YAML, proposed_camera_info."""

from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import PointCloud2
from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.collection import CollectionOptions, ViewCollection
from startracker_ros.core.calibration.estimate import calibrate, MIN_FRAME_STARS
from startracker_ros.core.calibration.matching import View
from startracker_ros.core.calibration.online import OnlineOptions
from startracker_ros.core.calibration.summary import sentence
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.io.bags.cloud_rows import centroids_from_rows
from startracker_ros.io.bags.layouts import ns_from_stamp, read_cloud, STAR_DTYPE
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.frames import InertialFrameOptions
from startracker_ros.ros.node import main_of
from startracker_ros.ros.odometry_input import OdometryInput
from startracker_ros.ros.online_lens import OnlineLens, OutputOptions


class CameraCalibratorNode(CameraNode):
    """Calibrates from identified stars on request, and from tracked stars in flight."""

    option_classes = (CollectionOptions, OutputOptions, OnlineOptions, AberrationOptions,
                      InertialFrameOptions)
    task = 'calibration'

    def __init__(self) -> None:
        super().__init__('camera_calibrator')
        self._observer = OdometryInput(self, InertialFrameOptions)
        self._online = None
        if self.options(OnlineOptions).calibration_mode != 'on_request':
            self._online = OnlineLens(self, self._observer)
        self.subscribe(PointCloud2, 'stars', self._on_stars, qos.LIST)
        self.advertise_trigger('calibrate', self._calibrate)
        self.advertise_reset()

    def restart(self) -> None:
        self._observer.rebuild()

    def builder(self, camera: Camera, epoch_year: float) -> Callable[[], OnboardCatalog]:
        return lambda: camera_stars(camera, epoch_year)

    def use(self, built: OnboardCatalog) -> None:
        assert self.camera is not None
        self._onboard = built
        self._collection = ViewCollection(self.camera, self.options(CollectionOptions))
        self._describe()
        if self._online is not None:
            self._online.rebuild(self.camera, self._onboard)

    def _on_stars(self, message: PointCloud2) -> None:
        rows = read_cloud(message, STAR_DTYPE)
        camera = self.camera_or_drop()
        if camera is None or not self.in_order('stars', message.header.stamp):
            return
        centroids = centroids_from_rows(rows)
        index = self._onboard.index_of(rows['hip'].astype(np.int32))
        known = (index >= 0) & (centroids.sigma_px > 0)
        if np.count_nonzero(known) < MIN_FRAME_STARS:
            self.diagnostics.counts['frames with too few stars'] += 1
            self.diagnostics.report(WARN, f'{np.count_nonzero(known)} identified stars in a '
                                    f'frame, {MIN_FRAME_STARS} are needed')
            return
        try:
            attitude = estimate_attitude(
                camera.unproject(centroids.uv[known]), self._onboard.direction[index[known]],
                centroids.sigma_px[known] * camera.pixel_rad)
        except AttitudeError as error:
            self.diagnostics.report(WARN, f'no attitude: {error}')
            return
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._observer.report(stamp_ns)
        kept = self._collection.add(View(
            centroids, attitude.quaternion, self._observer.motion.at(stamp_ns).state), known)
        self.diagnostics.counts['frames of a pointing already there'] += not kept
        self._describe()
        self.diagnostics.report(OK, 'collecting frames')

    def _describe(self) -> None:
        self.diagnostics.values.update({
            'frames': len(self._collection), 'stars': self._collection.stars,
            'field_covered_percent': f'{self._collection.covered_percent:.0f}'})

    def _calibrate(self) -> tuple[bool, str]:
        """Calibrate from the collected frames; return whether it worked, and the result."""
        if self.camera is None:
            return False, 'no valid camera_info received'
        output, done = self.options(OutputOptions).output_file, False
        try:
            calibration = calibrate(self._collection.views, self.camera, self._onboard)
            save_camera(calibration.camera, output)
        except CalibrationError as error:
            message = str(error)
        except OSError as error:
            message = f'output_file {output}: {error.strerror}'
        else:
            done, message = True, f'{sentence(calibration)}; written to {output}'
        self.get_logger().info(message)
        return done, message


main = main_of(CameraCalibratorNode)

if __name__ == '__main__':
    main()
