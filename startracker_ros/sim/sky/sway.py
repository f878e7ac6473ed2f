# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A smooth sway: what a flexible body, a ship or a telescope does."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.maths.rotation import (
    conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.sim.sky.motion_state import Motion, MotionState


@dataclass(frozen=True)
class SwayingMotion:
    """
    A motion with a sinusoidal turn added about an axis (3,) of unit length on sensor axes.

    angle = amplitude_rad sin(2 pi t / period_s + phase_rad).
    """

    steady: Motion
    axis: np.ndarray
    amplitude_rad: float
    period_s: float
    phase_rad: float = 0.0

    def at(self, time_s: float) -> MotionState:
        """Return the state."""
        state, w = self.steady.at(time_s), 2 * np.pi / self.period_s
        phase = w * time_s + self.phase_rad
        turn = quaternion_from_rotation_vector(self.axis * self.amplitude_rad * np.sin(phase))
        return replace(
            state, q_icrf_from_sensor=multiply(state.q_icrf_from_sensor, turn),
            rate_rad_s=rotate(conjugate(turn), state.rate_rad_s)
            + self.axis * self.amplitude_rad * w * np.cos(phase))
