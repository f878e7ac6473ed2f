# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude with respect to J2000, the Earth and the orbit, for users of these frames."""

from typing import Any

from geometry_msgs.msg import QuaternionStamped
import numpy as np
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.frames import gcrs_from_itrf, gcrs_from_j2000
from startracker_ros.core.astro.orbit import orbit_frame
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_matrix, sign_continuous)
from startracker_ros.ros import qos
from startracker_ros.ros.frames import ExtraFrameOptions
from startracker_ros.ros.messages.attitude import quaternion_to_message
from startracker_ros.ros.messages.header import make_header
from startracker_ros.ros.node import PipelineNode


class FramesOutput:
    """Publishes attitude_j2000, attitude_itrf and attitude_orbit where publish_frames is set."""

    def __init__(self, node: PipelineNode) -> None:
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._previous: dict[str, np.ndarray] = {}
        if node.options(ExtraFrameOptions).publish_frames:
            self._advertise()

    def _advertise(self) -> None:
        self._publishers = {
            frame: self._node.advertise(QuaternionStamped, f'attitude_{frame}', qos.LIST)
            for frame in ('j2000', 'itrf', 'orbit')}

    def publish(self, stamp_ns: int, q_icrf_from_sensor: np.ndarray, state: State | None) -> None:
        """Publish an attitude (4,); state is the odometry of its stamp, None without."""
        options = self._node.options(ExtraFrameOptions)
        if not options.publish_frames:
            return
        if not self._publishers:
            # The parameter is live.
            self._advertise()
        frames = {'j2000': gcrs_from_j2000(),
                  'itrf': gcrs_from_itrf(epoch_year_from_stamp(stamp_ns), options.ut1_utc_s)}
        if state is not None:
            frames['orbit'] = orbit_frame(state.position_m, state.velocity_m_s)
        for frame, icrf_from_frame in frames.items():
            q = multiply(conjugate(quaternion_from_matrix(icrf_from_frame)), q_icrf_from_sensor)
            self._previous[frame] = sign_continuous(q, self._previous.get(frame))
            self._publishers[frame].publish(quaternion_to_message(
                self._previous[frame], make_header(stamp_ns, frame)))
