# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fused attitude, the gyro drift and the mounts on their topics, the heads in diagnostics."""

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    PoseWithCovarianceStamped, QuaternionStamped, TwistWithCovarianceStamped)
import numpy as np
from sensor_msgs.msg import Imu
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.fusion.fusion import AttitudeFusion, FusedAttitude, hint_for
from startracker_ros.core.fusion.head import HeadState
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.options import option, Options
from startracker_ros.core.track.tracks import TrackedAttitude
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import OK, status_message, WARN
from startracker_ros.ros.frames import InertialFrameOptions
from startracker_ros.ros.messages.attitude import (
    attitude_to_imu, attitude_to_pose, hint_to_imu, mount_to_pose, quaternion_to_message,
    tracked_attitude_to_imu)
from startracker_ros.ros.messages.gyro import drift_to_twist
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import PipelineNode
from std_msgs.msg import Header

_NS = 1_000_000_000
_SILENT = 'silent'


@dataclass(frozen=True)
class BodyFrameOptions(Options):
    """The body in message headers."""

    body_frame_id: str = option('base_link', 'frame of the body')


class FusionOutput:
    """
    Publishes fused attitudes, drift and mounts, hints for heads without stars; reports the heads.

    frame_ids are the frames of the heads by name, for their hints.
    """

    def __init__(self, node: PipelineNode, heads: tuple[str, ...]) -> None:
        self._node = node
        self._quaternion = node.advertise(QuaternionStamped, 'attitude', qos.LIST)
        self._pose = node.advertise(PoseWithCovarianceStamped, 'attitude_cov', qos.LIST)
        self._imu = node.advertise(Imu, 'attitude_imu', qos.LIST)
        self._drift = node.advertise(TwistWithCovarianceStamped, 'gyro_drift', qos.LIST)
        self._mounts = {name: node.advertise(PoseWithCovarianceStamped, f'{name}/mount', qos.STATE)
                        for name in heads}
        self._hints = {name: node.advertise(Imu, f'{name}/hint', qos.LIST) for name in heads}
        self._heads = node.advertise(DiagnosticArray, 'heads', qos.STATE)
        self._conditions: dict[str, str] = {}
        self.frame_ids = dict.fromkeys(heads, '')
        self._mounts_ns: int | None = None
        self._published = self._reported = 0

    def publish(self, fusion: AttitudeFusion, stamp_ns: int, fused: FusedAttitude | None) -> None:
        """Publish what a frame has given; where there is no attitude attitude_imu is invalid."""
        body_frame_id = self._node.options(BodyFrameOptions).body_frame_id
        self._publish_heads(fusion, make_header(stamp_ns, body_frame_id))
        if fused is None:
            if fusion.trouble:
                self._imu.publish(attitude_to_imu(None, make_header(stamp_ns, body_frame_id)))
                self._node.diagnostics.counts['frames without attitude'] += 1
            return
        header = make_header(
            fused.stamp_ns, self._node.options(InertialFrameOptions).inertial_frame_id)
        body = make_header(fused.stamp_ns, body_frame_id)
        attitude = AttitudeEstimate(fused.quaternion, fused.covariance, 0, np.empty(0), 0.0)
        self._quaternion.publish(quaternion_to_message(fused.quaternion, header))
        self._pose.publish(attitude_to_pose(attitude, header))
        self._imu.publish(tracked_attitude_to_imu(
            TrackedAttitude(attitude, fused.rate_rad_s, fused.rate_covariance), body))
        self._drift.publish(drift_to_twist(fused.drift_rad_s, fused.drift_covariance, body))
        for name, publisher in self._hints.items():
            if fusion.is_missing(name, fused.stamp_ns) and publisher.get_subscription_count():
                publisher.publish(hint_to_imu(hint_for(fusion, name, fused), make_header(
                    fused.stamp_ns, self.frame_ids[name])))
        self._node.diagnostics.counts['attitudes'] += 1
        self._published += 1
        sigma = np.sqrt(np.diag(fused.covariance)) / ARCSEC
        self._node.diagnostics.values['sigma_arcsec'] = ' '.join(f'{s:.2f}' for s in sigma)
        if self._mounts_ns is None or abs(fused.stamp_ns - self._mounts_ns) >= _NS:
            self._mounts_ns = fused.stamp_ns
            for name, publisher in self._mounts.items():
                publisher.publish(mount_to_pose(*fusion.mounts.at(name, fused.stamp_ns), body))
        for step in fusion.steps:
            size = float(np.linalg.norm(step.size_rad)) / ARCSEC
            self._node.diagnostics.report_event(
                f'mount of {step.head} has moved by {size:.1f} arcsec at '
                f'{step.stamp_ns / _NS:.0f} s')
        fusion.steps.clear()

    def _publish_heads(self, fusion: AttitudeFusion, header: Header) -> None:
        """Publish which heads count, when that has changed: silent are those without frames."""
        stamp_ns = ns_from_stamp(header.stamp)
        conditions = {
            name: _SILENT if head.state is HeadState.USED and fusion.is_missing(name, stamp_ns)
            else str(head.state) for name, head in fusion.heads.items()}
        if conditions == self._conditions:
            return
        self._conditions = conditions
        self._heads.publish(DiagnosticArray(header=header, status=[status_message(
            f'attitude_fusion: {name}', name, OK if text == HeadState.USED else WARN, text,
            {'reason': fusion.heads[name].reason}) for name, text in conditions.items()]))

    def report(self, fusion: AttitudeFusion | None) -> None:
        """Report the condition of the heads."""
        diagnostics = self._node.diagnostics
        if fusion is None:
            diagnostics.report(WARN, 'no mounts_file: the mounts of the heads are unknown')
            return
        troubles = []
        for name, head in fusion.heads.items():
            reason = head.reason
            if head.state is HeadState.WAITING and diagnostics.counts[f'{name} without attitude']:
                # Mirrored, of another focal length, or blinded from the start.
                reason = 'its tracker has no attitude'
            diagnostics.values[name] = f'{head.state}: {reason}' if reason else str(head.state)
            diagnostics.values.update({f'{name} {key}': count
                                       for key, count in head.counts.items()})
            if head.state is not HeadState.USED or reason:
                troubles.append(f'{name} {head.state}: {reason}')
            if head.stands_out:
                troubles.append(f'{name}: errors {head.noise_scale ** 0.5:.1f} times as large as '
                                'its covariance says, which is enlarged')
            if head.needs_temperature:
                troubles.append(f'{name}/temperature is missing: its mount bends with it')
        if fusion.gyro_trouble:
            troubles.append(fusion.gyro_trouble)
        diagnostics.values['gyro'] = 'used' if fusion.uses_gyro else 'unused'
        new, self._reported = self._published - self._reported, self._published
        if not new:
            diagnostics.report(WARN, '; '.join(
                [f'no attitude: {fusion.trouble or "no frames"}', *troubles]))
        elif troubles:
            diagnostics.report(WARN, '; '.join(['publishing attitude', *troubles]))
        else:
            diagnostics.report(OK, 'publishing attitude')
