# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motion of the observer out of its odometry, for the nodes that correct aberration."""

from nav_msgs.msg import Odometry
from startracker_ros.core.astro.observer_motion import (
    AberrationOptions, MotionError, ObserverMotion)
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
from startracker_ros.io.bags.telemetry import state_from_odometry
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frames import InertialFrameOptions


class OdometryInput:
    """
    Subscribes to odometry; motion is that of the observer by the options of the node.

    frames is the options class of the node that names the frame of odometry.
    """

    def __init__(self, node: CameraNode, frames: type[InertialFrameOptions]) -> None:
        self._node = node
        self._frames = frames
        self._logged = ''
        self.rebuild()
        node.subscribe(Odometry, 'odometry', self._on_odometry, qos.LIST)

    def rebuild(self) -> None:
        """Begin without odometry, with the options and the epoch of now."""
        self.motion = ObserverMotion(self._node.options(AberrationOptions), self._node.epoch)

    def report(self, stamp_ns: int) -> None:
        """Report which velocities the frame of a stamp was corrected for."""
        observer = self.motion.at(stamp_ns)
        self._node.diagnostics.values['aberration'] = observer.condition
        if observer.used != self._logged:
            self._logged = observer.used
            self._node.get_logger().info(f'aberration: {observer.condition}')
        if observer.trouble:
            self._node.diagnostics.report_event(f'aberration: {observer.condition}')

    def _on_odometry(self, message: Odometry) -> None:
        state = state_from_odometry(message, self._node.options(self._frames).inertial_frame_id)
        try:
            self.motion.add_state(ns_from_stamp(message.header.stamp), state)
        except MotionError as error:
            raise MessageError(str(error)) from error
