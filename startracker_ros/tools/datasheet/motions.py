# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motions of a Monte Carlo: many pointings in turn, and turns that get faster."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.tools.datasheet.instrument import ORBIT

RUN_S = 100.0
"""Time between the beginnings of two runs of Spins."""


@dataclass(frozen=True)
class Pointings:
    """
    Independent pointings, number k around second k.

    quaternion (N, 4) is q_icrf_from_sensor at that second, rate_rad_s (N, 3) the constant rate
    on sensor axes around it: one simulator renders all of them.
    """

    quaternion: np.ndarray
    rate_rad_s: np.ndarray

    def at(self, time_s: float) -> MotionState:
        """Return the state."""
        index = int(np.rint(time_s))
        rate_rad_s = self.rate_rad_s[index]
        turn = quaternion_from_rotation_vector(rate_rad_s * (time_s - index))
        return MotionState(multiply(self.quaternion[index], turn), rate_rad_s, *ORBIT.at(time_s))


@dataclass(frozen=True)
class Spins:
    """
    Turns about fixed axes, number k from second k RUN_S on.

    Each of q_start (N, 4) turns about its axis (N, 3) on sensor axes at rate_rad_s, which grows
    by acceleration_rad_s2 from start_s after its beginning.
    """

    q_start: np.ndarray
    axis: np.ndarray
    rate_rad_s: float
    acceleration_rad_s2: float
    start_s: float

    def at(self, time_s: float) -> MotionState:
        """Return the state; half of the time of a run belongs to what is before its beginning."""
        run = int(np.rint(time_s / RUN_S))
        within_s = time_s - run * RUN_S
        since_s = max(within_s - self.start_s, 0.0)
        angle_rad = self.rate_rad_s * within_s + self.acceleration_rad_s2 * since_s ** 2 / 2
        rate_rad_s = self.rate_rad_s + self.acceleration_rad_s2 * since_s
        turn = quaternion_from_rotation_vector(angle_rad * self.axis[run])
        return MotionState(multiply(self.q_start[run], turn), rate_rad_s * self.axis[run],
                           *ORBIT.at(time_s))


def across_boresight(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random axes (count, 3) across the boresight: the stars move over the image."""
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], -1)
