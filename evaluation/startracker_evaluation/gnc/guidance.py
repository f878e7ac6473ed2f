# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reference attitudes: fixed ones, and slews from rest to rest."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector, rotate


@dataclass(frozen=True)
class Reference:
    """
    The attitude that the body is to have at one instant.

    quaternion (4,) is q_icrf_from_body; rate_icrf_rad_s (3,) and acceleration_icrf_rad_s2 (3,)
    are on ICRF axes.
    """

    quaternion: np.ndarray
    rate_icrf_rad_s: np.ndarray
    acceleration_icrf_rad_s2: np.ndarray

    @classmethod
    def fixed(cls, quaternion: np.ndarray) -> 'Reference':
        """Return an attitude at rest."""
        return cls(quaternion, np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class Slew:
    """
    A turn by angle_rad about axis (3,) on body axes, from q_start (4,) at rest at begin_s.

    The rate rises as (1 - cos(pi t / ramp_s)) / 2 to peak_rad_s and falls alike, so that the
    acceleration has no steps.
    """

    q_start: np.ndarray
    axis: np.ndarray
    angle_rad: float
    begin_s: float
    peak_rad_s: float = np.radians(1.0)
    ramp_s: float = 20.0

    @property
    def end_s(self) -> float:
        """Return when the body is to be at rest again."""
        return self.begin_s + self.angle_rad / self.peak_rad_s + self.ramp_s

    def at(self, time_s: float) -> Reference:
        """Return the reference of a time; before and after the slew it is at rest."""
        since_s = np.clip(time_s, self.begin_s, self.end_s) - self.begin_s
        left_s = self.end_s - self.begin_s - since_s
        if min(since_s, left_s) < self.ramp_s:
            angle, rate, acceleration = self._ramp(min(since_s, left_s))
            if left_s < since_s:
                angle, acceleration = self.angle_rad - angle, -acceleration
        else:
            angle, rate, acceleration = (
                self.peak_rad_s * (since_s - self.ramp_s / 2), self.peak_rad_s, 0.0)
        axis = rotate(self.q_start, self.axis)
        turn = quaternion_from_rotation_vector(self.axis * angle)
        return Reference(multiply(self.q_start, turn), axis * rate, axis * acceleration)

    def _ramp(self, t: float) -> tuple[float, float, float]:
        """Return angle, rate and acceleration so long after the begin, or before the end."""
        w = np.pi / self.ramp_s
        return (self.peak_rad_s * (t - np.sin(w * t) / w) / 2,
                self.peak_rad_s * (1 - np.cos(w * t)) / 2, self.peak_rad_s * w * np.sin(w * t) / 2)
