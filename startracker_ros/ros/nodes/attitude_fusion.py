# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""attitude_fusion: frame_attitude of several heads, imu, temperature -> attitude of the body."""

from functools import partial

import numpy as np
from sensor_msgs.msg import Imu, Temperature
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.head import HeadFrame
from startracker_ros.core.fusion.mounts import load_mounts, Mount, MountOptions, save_mounts
from startracker_ros.core.fusion.options import FusionOptions, HeadsOptions, NO_ROTATION
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.io.bags.layouts import MessageError, ns_from_stamp
from startracker_ros.io.bags.telemetry import rate_from_imu
from startracker_ros.ros import qos
from startracker_ros.ros.frames import InertialFrameOptions
from startracker_ros.ros.fusion_output import BodyFrameOptions, FusionOutput
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.node import main_of, PipelineNode, StartError


class AttitudeFusionNode(PipelineNode):
    """Fuses the attitudes of several heads, checked against each other, with the gyro."""

    option_classes = (HeadsOptions, FusionOptions, MountOptions, GyroErrorOptions,
                      BodyFrameOptions, InertialFrameOptions)
    task = 'fusion'

    def __init__(self) -> None:
        super().__init__('attitude_fusion')
        options: HeadsOptions = self.options(HeadsOptions)
        twice = {name for name in options.heads if options.heads.count(name) > 1}
        if twice or not all(options.heads):
            raise StartError(f'heads = {list(options.heads)} must be different namespaces')
        self._fusion: AttitudeFusion | None = None
        self._output = FusionOutput(self, options.heads)
        for name in options.heads:
            self.subscribe(Imu, f'{name}/{options.head_topic}', partial(self._on_head, name),
                           qos.LIST)
            self.subscribe(Temperature, f'{name}/temperature',
                           partial(self._on_temperature, name), qos.LIST)
        self.subscribe(Imu, 'imu', self._on_imu, qos.IMU, first=True)
        self.advertise_trigger('save_mounts', self._save_mounts)
        self.advertise_reset()
        self.diagnostics.checks.append(lambda: self._output.report(self._fusion))

    def rebuild(self) -> None:
        options: HeadsOptions = self.options(HeadsOptions)
        self._q_body_from_imu = np.array(options.imu_quaternion)
        if abs(np.linalg.norm(self._q_body_from_imu) - 1) > 1e-3:
            raise StartError(f'imu_quaternion = {list(options.imu_quaternion)} is not a rotation')
        self._fusion = None
        if not options.mounts_file and len(options.heads) > 1:
            return
        try:
            mounts = (load_mounts(options.mounts_file, options.heads) if options.mounts_file
                      else {options.heads[0]: Mount(np.array(NO_ROTATION))})
            self._fusion = AttitudeFusion(
                mounts, self.options(FusionOptions), self.options(MountOptions),
                self.options(GyroErrorOptions))
        except ValueError as error:
            raise StartError(str(error)) from error

    def _on_head(self, name: str, message: Imu) -> None:
        self._output.frame_ids[name] = message.header.frame_id
        tracked = tracked_attitude_from_imu(message)
        if self._fusion is None or tracked is None:
            self.diagnostics.counts[f'{name} without attitude'] += tracked is None
            return
        try:
            frame = HeadFrame(ns_from_stamp(message.header.stamp), tracked.attitude.quaternion,
                              tracked.attitude.covariance_sensor)
        except ValueError as error:
            raise MessageError(str(error)) from error
        self._output.publish(self._fusion, frame.stamp_ns, self._fusion.add_frame(name, frame))

    def _on_temperature(self, name: str, message: Temperature) -> None:
        if self._fusion is not None and not self._fusion.heads[name].set_temperature(
                message.temperature):
            raise MessageError(f'{message.temperature:g} degC is not a temperature of a head: '
                               'degrees Celsius, not kelvin')

    def _on_imu(self, message: Imu) -> None:
        rate = rotate(self._q_body_from_imu, rate_from_imu(message))
        stamp_ns = ns_from_stamp(message.header.stamp)
        if self._fusion is not None and not self._fusion.add_rate(stamp_ns, rate):
            raise MessageError(f'angular velocity {rate.tolist()} rad/s cannot be right, or its '
                               'stamp is not newer than the last')

    def _save_mounts(self) -> tuple[bool, str]:
        """Write the mounts as estimated so far; return whether it worked, and where they are."""
        path = self.options(HeadsOptions).output_file
        if self._fusion is None:
            return False, 'no mounts_file: there are no mounts'
        try:
            save_mounts(self._fusion.mounts.estimated(), path)
        except OSError as error:
            return False, f'output_file {path}: {error.strerror}'
        return True, f'mounts written to {path}'


main = main_of(AttitudeFusionNode)

if __name__ == '__main__':
    main()
