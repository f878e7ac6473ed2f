# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The true state of a simulated sensor at an instant, and what gives it at any time."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from startracker_ros.core.astro.state import State
from startracker_ros.core.maths.rotation import conjugate, multiply, rotate


@dataclass(frozen=True)
class MotionState:
    """
    Truth at one instant.

    q_icrf_from_sensor (4,); rate_rad_s (3,), the angular velocity with respect to ICRF
    on sensor axes; position_m and velocity_m_s (3,), geocentric on ICRF axes.
    """

    q_icrf_from_sensor: np.ndarray
    rate_rad_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray

    @property
    def geocentric(self) -> State:
        """Return position and velocity as a navigation without errors reports them."""
        return State(self.position_m, self.velocity_m_s, np.zeros((3, 3)))

    def turned(self, turn: np.ndarray, rate_rad_s: np.ndarray | list[float]) -> 'MotionState':
        """Return the state after a turn (4,) that goes on at a rate (3,) on the new axes."""
        return replace(self, q_icrf_from_sensor=multiply(self.q_icrf_from_sensor, turn),
                       rate_rad_s=rotate(conjugate(turn), self.rate_rad_s) + rate_rad_s)


class Motion(Protocol):
    """The true state at any time, in s since the start of the simulation."""

    def at(self, time_s: float) -> MotionState:
        """Return the state; times may come in any order."""
