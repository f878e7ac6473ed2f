# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude at more times than there are frames, by the motion that the tracker knows."""

from dataclasses import dataclass, replace

from geometry_msgs.msg import AccelWithCovarianceStamped
import numpy as np
from sensor_msgs.msg import Imu
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.frame_result import Attitude
from startracker_ros.core.options import option, Options
from startracker_ros.core.track.tracks import Acceleration, TrackedAttitude
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.camera_node import CameraNode
from startracker_ros.ros.frame_pairs import FramePairs
from startracker_ros.ros.messages.attitude import (
    acceleration_from_message, tracked_attitude_to_imu)
from startracker_ros.ros.messages.header import make_header

LONGEST_NS = 1_000_000_000
"""Interval of two frames beyond which the motion between them is not known well enough."""


@dataclass(frozen=True)
class SubFrameOptions(Options):
    """How many attitudes each frame gives."""

    sub_frames: int = option(
        0, 'attitudes published as sub_frame_attitude for each frame, evenly over a frame '
        'interval about its stamp, by rate and acceleration of the star tracker; 0: none',
        low=0, high=64, read_only=True)


class SubFrameOutput:
    """Publishes sub_frame_attitude of frames whose tracked_acceleration has come."""

    def __init__(self, node: CameraNode) -> None:
        self._node = node
        self._count = node.options(SubFrameOptions).sub_frames
        self._pairs = FramePairs('attitude', 'tracked_acceleration')
        self._before_ns = 0
        if self._count:
            self._publisher = node.advertise(Imu, 'sub_frame_attitude', qos.LIST)
            node.subscribe(AccelWithCovarianceStamped, 'tracked_acceleration',
                           self._on_acceleration, qos.LIST)

    def clear(self) -> None:
        """Forget the frames so far."""
        self._pairs.clear()
        self._before_ns = 0

    def add(self, stamp_ns: int, attitude: AttitudeEstimate | None, tracked: TrackedAttitude
            ) -> None:
        """Add the trusted attitude of a newer frame, None without one, with its rate."""
        interval_ns, self._before_ns = stamp_ns - self._before_ns, stamp_ns
        if self._count and attitude is not None and interval_ns <= LONGEST_NS:
            self._publish(self._pairs.add('attitude', stamp_ns, (
                stamp_ns, interval_ns, attitude, tracked)))

    def _on_acceleration(self, message: AccelWithCovarianceStamped) -> None:
        self._publish(self._pairs.add('tracked_acceleration', ns_from_stamp(message.header.stamp),
                                      acceleration_from_message(message)))

    def _publish(self, pair: tuple | None) -> None:
        if pair is None:
            return
        (stamp_ns, interval_ns, own, tracked), (mean, sigma) = pair
        attitude = Attitude.of(stamp_ns, own, tracked, Acceleration(
            mean, sigma, np.zeros(3), sigma))
        for one in attitude.sub_frames(self._count, interval_ns):
            self._publisher.publish(tracked_attitude_to_imu(
                replace(tracked, attitude=one, rate_rad_s=one.rate_rad_s,
                        rate_covariance=one.rate_covariance),
                make_header(one.stamp_ns, self._node.sensor_frame_id)))
        self._node.diagnostics.counts['frames with sub-frames'] += 1
