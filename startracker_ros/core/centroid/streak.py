# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Streak of a star that moves during the exposure: its length and direction over the image.

A turn of the camera moves all stars together. To first order the streak (du, dv) of a star at
(u, v) is that of the middle of the image plus what the roll adds,

    du = u_px - roll (v - v0),  dv = v_px + roll (u - u0).

A streak and its opposite are the same: an image does not show the direction of time.
"""

import math
from typing import NamedTuple

import numpy as np

SHORTEST_PX = 1.0  # a shorter streak is fitted as a point


class Streak(NamedTuple):
    """Streak (u_px, v_px) at the pixel (u0, v0), and the roll in rad during the exposure."""

    u_px: float
    v_px: float
    roll: float
    u0: float
    v0: float

    def at(self, uv: np.ndarray) -> np.ndarray:
        """Return the streaks (N, 2) in px of stars at uv (N, 2)."""
        across, down = uv[:, 0] - self.u0, uv[:, 1] - self.v0
        return np.stack([self.u_px - self.roll * down, self.v_px + self.roll * across], -1)

    @property
    def length_px(self) -> float:
        """Length in the middle of the image."""
        return math.hypot(self.u_px, self.v_px)
