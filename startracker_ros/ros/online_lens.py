# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Calibration in flight for a node behind a camera: tracked stars in, better cameras out."""

from dataclasses import dataclass
import math
from typing import Any

from sensor_msgs.msg import CameraInfo, PointCloud2, Temperature
from sensor_msgs.srv import SetCameraInfo
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.collection import CollectionOptions
from startracker_ros.core.calibration.online import OnlineCalibration, OnlineOptions, Proposal
from startracker_ros.core.calibration.tracked_frames import tracked_frame
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.diagnostics import OK, WARN
from startracker_ros.ros.frame_pairs import FramePairs
from startracker_ros.ros.messages.clouds import centroids_from_message, tracks_from_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.messages.image import camera_to_message
from startracker_ros.ros.odometry_input import OdometryInput
from std_msgs.msg import Header


@dataclass(frozen=True)
class OutputOptions(Options):
    """Where the calibration goes."""

    output_file: str = option(
        'camera.yaml', 'file that ~/calibrate and proposals write, as camera_calibration does',
        read_only=True)


class OnlineLens:
    """Pairs centroids with tracks of one stamp, publishes, writes and applies proposals."""

    def __init__(self, node: CameraNode, observer: OdometryInput) -> None:
        self._node = node
        self._observer = observer
        self._output_file = node.options(OutputOptions).output_file
        self._calibration: OnlineCalibration | None = None
        self._wanted: Camera | None = None
        self._temperature_c = math.nan
        self._pairs = FramePairs('centroids', 'tracks')
        self._applies = node.options(OnlineOptions).calibration_mode == 'apply'
        self._proposed = node.advertise(CameraInfo, 'proposed_camera_info', qos.STATE)
        node.subscribe(PointCloud2, 'centroids', self._on_centroids, qos.LIST)
        node.subscribe(PointCloud2, 'tracks', self._on_tracks, qos.LIST)
        node.subscribe(Temperature, 'temperature', self._on_temperature, qos.LIST)
        if self._applies:
            self._source = node.create_client(SetCameraInfo, 'set_camera_info')

    def rebuild(self, camera: Camera, onboard: OnboardCatalog) -> None:
        """Begin with a camera, or go on when it is the one that was proposed."""
        self._onboard = onboard
        self._pairs.clear()
        if self._calibration is not None and camera.is_same(self._wanted):
            self._calibration.use(camera)
        else:
            self._calibration = OnlineCalibration(
                camera, self._node.options(OnlineOptions), self._node.options(CollectionOptions))
        self._wanted = None

    def _on_temperature(self, message: Temperature) -> None:
        if not -273.15 <= message.temperature <= 1000.0:
            raise MessageError(f'{message.temperature:g} degC is not a temperature')
        self._temperature_c = message.temperature

    def _on_centroids(self, message: PointCloud2) -> None:
        self._pair('centroids', message.header, centroids_from_message(message))

    def _on_tracks(self, message: PointCloud2) -> None:
        tracks = tracks_from_message(message)
        if self._node.in_order('tracks', message.header.stamp):
            self._pair('tracks', message.header, tracks)

    def _pair(self, topic: str, header: Header, value: Any) -> None:
        """Use a frame of which both clouds have come."""
        stamp_ns = ns_from_stamp(header.stamp)
        pair, camera = self._pairs.add(topic, stamp_ns, value), self._node.camera_or_drop()
        if pair is None or camera is None or self._calibration is None:
            return
        centroids, tracks = pair
        if not len(tracks):
            return
        observer = self._observer.motion.at(stamp_ns).state
        try:
            proposal = self._calibration.add(tracked_frame(
                camera, self._onboard, stamp_ns, centroids, tracks, observer, self._temperature_c))
        except CalibrationError as error:
            self._node.diagnostics.counts['tracked frames rejected'] += 1
            self._node.diagnostics.report(WARN, f'tracks: {error}')
            return
        self._describe(self._calibration)
        if proposal is not None:
            self._propose(proposal, stamp_ns, header.frame_id)

    def _describe(self, calibration: OnlineCalibration) -> None:
        self._node.diagnostics.report(OK, 'calibrating from tracked stars')
        self._node.diagnostics.values.update({
            **{f'tracked frames {name}': count for name, count in calibration.frames.items()},
            **{f'lens_{name}': f'{value:.6g} +- {sigma:.2g}' for name, (value, sigma)
               in calibration.filter.figures(self._temperature_c).items()}})

    def _propose(self, proposal: Proposal, stamp_ns: int, frame_id: str) -> None:
        message = camera_to_message(proposal.camera, make_header(stamp_ns, frame_id))
        self._proposed.publish(message)
        self._node.diagnostics.counts['cameras proposed'] += 1
        self._node.diagnostics.report_event(f'camera proposed: {proposal}')
        self._wanted = proposal.camera
        try:
            save_camera(proposal.camera, self._output_file)
        except OSError as error:
            self._node.diagnostics.report_event(
                f'output_file {self._output_file}: {error.strerror}')
        if not self._applies:
            return
        if not self._source.service_is_ready():
            self._node.diagnostics.report_event(
                'no service set_camera_info: the proposed camera is not applied')
            return
        self._source.call_async(SetCameraInfo.Request(camera_info=message)).add_done_callback(
            self._on_response)

    def _on_response(self, future: object) -> None:
        response = future.result()  # type: ignore[attr-defined]
        if not response.success:
            self._node.diagnostics.report_event(
                f'set_camera_info rejects the proposed camera: {response.status_message}')
            return
        self._node.diagnostics.counts['cameras applied'] += 1
