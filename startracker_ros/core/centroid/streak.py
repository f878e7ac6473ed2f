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
from startracker_ros.core.compiled import compiled

SHORTEST_PX = 1.0  # a shorter streak is fitted as a point
CLOSE_SHARE, CLOSE_PX = 0.3, 0.5  # of the length, by which the estimates of one streak differ


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

    def scaled(self, factor: float) -> 'Streak':
        """Return the streak of an exposure that is longer by a factor."""
        return self._replace(u_px=factor * self.u_px, v_px=factor * self.v_px,
                             roll=factor * self.roll)

    def is_close(self, other: 'Streak') -> bool:
        """Return whether another streak is the same, or its opposite, but for its error."""
        here, there = np.array(self[:2]), np.array(other[:2])
        distance = min(np.linalg.norm(here - there), np.linalg.norm(here + there))
        return bool(distance < max(CLOSE_SHARE * self.length_px, CLOSE_PX))

    def joined(self, other: 'Streak') -> 'Streak':
        """
        Return the streak of images that are moved along both, by their second moments.

        What both spread across it is left to the PSF; the roll is that of the longer one.
        """
        moments = np.outer(self[:2], self[:2]) + np.outer(other[:2], other[:2])
        (least, most), axes = np.linalg.eigh(moments)
        u_px, v_px = np.sqrt(most - least) * axes[:, 1]
        longer = max(self, other, key=lambda streak: streak.length_px)
        sign = np.sign(u_px * longer.u_px + v_px * longer.v_px)
        return longer._replace(u_px=float(sign * u_px), v_px=float(sign * v_px))

    def longest_px(self) -> float:
        """Return the length in the farthest corner of an image whose middle is (u0, v0)."""
        return self.length_px + abs(self.roll) * math.hypot(self.u0, self.v0)


@compiled
def fit_streak(uv: np.ndarray, streak_px: np.ndarray, weight: np.ndarray,
               shape: tuple[int, int]) -> Streak:
    """
    Return the common streak of stars at uv (N, 2) with streaks (N, 2), by least squares.

    The streaks point into the same half plane, weight (N,) is 1 / variance, shape (H, W) that of
    the image. The roll is estimated from four stars on; it is zero for fewer.
    """
    v0, u0 = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    total = mean_u = mean_v = shift_u = shift_v = 0.0
    for i in range(len(uv)):
        total += weight[i]
        mean_u, mean_v = mean_u + weight[i] * uv[i, 0], mean_v + weight[i] * uv[i, 1]
        shift_u += weight[i] * streak_px[i, 0]
        shift_v += weight[i] * streak_px[i, 1]
    mean_u, mean_v, shift_u, shift_v = (mean_u / total, mean_v / total, shift_u / total,
                                        shift_v / total)
    # About the mean of the stars the roll is independent of the shift.
    spread = moment = 0.0
    for i in range(len(uv)):
        u, v = uv[i, 0] - mean_u, uv[i, 1] - mean_v
        spread += weight[i] * (u * u + v * v)
        moment += weight[i] * (u * (streak_px[i, 1] - shift_v) - v * (streak_px[i, 0] - shift_u))
    roll = moment / spread if len(uv) >= 4 and spread > 0 else 0.0
    return Streak(shift_u + roll * (mean_v - v0), shift_v - roll * (mean_u - u0), roll, u0, v0)
