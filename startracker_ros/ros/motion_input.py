# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motion of a dynamics simulator: one image for each message, or images at the frame rate."""

from collections.abc import Callable
from dataclasses import dataclass, replace
import time

from nav_msgs.msg import Odometry
import numpy as np
from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos
from startracker_ros.ros.diagnostics import WARN
from startracker_ros.ros.frames import FrameOptions
from startracker_ros.ros.messages.odometry import motion_from_odometry
from startracker_ros.ros.source import SourceNode, SourceOptions
from startracker_ros.sim.sky.motion import MotionOptions
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.mounted import HeadOptions
from startracker_ros.sim.sky.sampled_motion import SampledMotion

TOPIC = 'motion/odometry'
MAX_GAP_S = 1.0
"""There is no image between messages that are farther apart: the motion is not known."""

_SILENT_S = 2.0
_TICK_S = 0.1
# Of the turn between two messages, and at least; beyond, attitude and rate contradict each other.
_DISAGREEMENT, _DISAGREEMENT_RAD = 0.1, 1e-3


@dataclass(frozen=True)
class MotionInputOptions(Options):
    """When an image is due if the motion is that of a topic."""

    lock_step: bool = option(
        False, 'with motion: topic: one image for each message of motion/odometry, at its stamp; '
        'otherwise images at frame_rate_hz of the stamps, in an interpolated motion')


class MotionInput:
    """
    Subscribes to motion/odometry once the node has its users, and calls for the images.

    begin(stamp_ns) is called with the first stamp, and with the first after a jump back of time;
    publish(index, stamp_ns, time_s) for each image. Stamps alone set the pace: no clock is read,
    so that simulated time may be faster or slower than real time.
    """

    def __init__(self, node: SourceNode, begin: Callable[[int], None],
                 publish: Callable[[int, int, float], None]) -> None:
        self._node = node
        self._begin, self._publish = begin, publish
        self._has_users: Callable[[int], bool] | None = None
        self._subscribed = False
        self.rebuild(None, 0.0)
        node.create_steady_timer(_TICK_S, self._tick)

    def rebuild(self, has_users: Callable[[int], bool] | None, reach_s: float) -> None:
        """
        Restart with the next message; without has_users messages are ignored.

        has_users(stamp_ns) returns whether the subscribers of the images are there; reach_s is
        how far an exposure extends to either side of its stamp.
        """
        self._has_users, self._reach_s = has_users, reach_s
        self.motion = SampledMotion()
        self._newest_ns: int | None = None
        self._first_ns = self._index = 0
        self._due_from_ns = self._due_index = 0
        self._received_s = time.monotonic()
        self._subscribe_if_used()

    def _tick(self) -> None:
        """Subscribe once there are users; report silence."""
        node = self._node
        if self._has_users is None or not node.active:
            self._received_s = time.monotonic()
            return
        if not self._subscribed:
            self._received_s = time.monotonic()
            self._subscribe_if_used()
        silent_s = time.monotonic() - self._received_s
        if silent_s > _SILENT_S:
            node.diagnostics.report(WARN, f'no {TOPIC} for {silent_s:.0f} s: no images')

    def _subscribe_if_used(self) -> None:
        node = self._node
        if (self._has_users is not None and not self._subscribed
                and self._has_users(node.get_clock().now().nanoseconds)):
            self._subscribed = True
            node.subscribe(Odometry, TOPIC, self._on_motion, qos.LIST)

    def _on_motion(self, message: Odometry) -> None:
        if self._has_users is None:
            return
        node, frames = self._node, self._node.options(FrameOptions)
        state = motion_from_odometry(
            message, frames.inertial_frame_id,
            node.options(HeadOptions).body_frame_id or frames.sensor_frame_id)
        stamp_ns, counts = ns_from_stamp(message.header.stamp), node.diagnostics.counts
        self._received_s = time.monotonic()
        back_ns = -1 if self._newest_ns is None else self._newest_ns - stamp_ns
        if back_ns > RESTART_NS:
            back_s = back_ns * 1e-9
            counts[f'{TOPIC} restarts'] += 1
            node.diagnostics.report_event(
                f'{TOPIC}: time went back by {back_s:.1f} s, the motion restarts')
            self.rebuild(self._has_users, self._reach_s)
        elif back_ns >= 0:
            counts[f'{TOPIC} out of order'] += 1
            node.diagnostics.report(WARN, f'{TOPIC}: message out of order dropped')
            return
        if self._newest_ns is None:
            self._first_ns = stamp_ns
            self._begin(stamp_ns)
        self._newest_ns = stamp_ns
        self._add((stamp_ns - self._first_ns) * 1e-9, state)
        self._publish_due(stamp_ns)

    def _add(self, time_s: float, state: MotionState) -> None:
        """Add a sample, along the orbit of the parameters if it has none; report oddities."""
        if not state.position_m.any():
            position_m, velocity_m_s = self._node.options(MotionOptions).orbit.at(time_s)
            state = replace(state, position_m=position_m, velocity_m_s=velocity_m_s)
        events, before_s = self._node.diagnostics, self.motion.newest_s
        disagreement_rad = self.motion.add(time_s, state)
        allowed_rad = _DISAGREEMENT_RAD + _DISAGREEMENT * float(
            np.linalg.norm(state.rate_rad_s)) * (time_s - max(before_s, 0.0))
        if np.isinf(disagreement_rad):
            events.counts[f'{TOPIC} too far apart'] += 1
            events.report_event(f'{TOPIC}: turned by more than 90 deg between two messages')
        elif disagreement_rad > allowed_rad:
            events.counts[f'{TOPIC} contradictory'] += 1
            events.report_event(
                f'{TOPIC}: attitude and rate disagree by {np.degrees(disagreement_rad):.2f} deg: '
                'the rate is to be on the axes of child_frame_id')
        if time_s - max(before_s, 0.0) > MAX_GAP_S and not self._options.lock_step:
            events.counts[f'{TOPIC} gaps'] += 1
            events.report_event(f'{TOPIC}: nothing for {time_s - before_s:.1f} s, no images')
            self._due_from_ns, self._due_index = round((time_s + self._reach_s) * 1e9), 0

    def _publish_due(self, stamp_ns: int) -> None:
        """Publish the image of this message, or all that the motion is known for."""
        since_ns = stamp_ns - self._first_ns
        if self._options.lock_step:
            self._publish_next(since_ns)
            return
        known_ns = since_ns - round(self._reach_s * 1e9)
        while (due_ns := self._due_ns()) <= known_ns:
            self._publish_next(due_ns)
            self._due_index += 1

    def _due_ns(self) -> int:
        """Return when the next image is due, counted from the first message."""
        rate_hz = self._node.options(SourceOptions).frame_rate_hz
        return self._due_from_ns + round(self._due_index / rate_hz * 1e9)

    def _publish_next(self, since_ns: int) -> None:
        count = self._node.options(SourceOptions).frame_count
        if not count or self._index < count:
            self._publish(self._index, self._first_ns + since_ns, since_ns / 1e9)
            self._index += 1

    @property
    def _options(self) -> MotionInputOptions:
        return self._node.options(MotionInputOptions)
