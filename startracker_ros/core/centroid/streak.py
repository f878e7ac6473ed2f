# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Streak of a star that moves during the exposure: its length and direction over the image.

A turn of the camera moves all stars together. To first order the streak (du, dv) of a star at
(u, v) is that of the middle of the image plus what the roll adds,

    du = u_px - roll (v - v0),  dv = v_px + roll (u - u0).

A streak and its opposite are the same: an image does not show the direction of time.
"""

from typing import NamedTuple

import numpy as np

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
        return float(np.hypot(self.u_px, self.v_px))

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
        return self.length_px + abs(self.roll) * float(np.hypot(self.u0, self.v0))


def fit_streak(uv: np.ndarray, streak_px: np.ndarray, weight: np.ndarray,
               shape: tuple[int, int]) -> Streak:
    """
    Return the common streak of stars at uv (N, 2) with streaks (N, 2), by least squares.

    The streaks point into the same half plane, weight (N,) is 1 / variance, shape (H, W) that of
    the image. The roll is estimated from four stars on; it is zero for fewer.
    """
    v0, u0 = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    # About the mean of the stars the roll is independent of the shift.
    share = weight / weight.sum()
    mean, shift = share @ uv, share @ streak_px
    (u, v), (moved_u, moved_v) = (uv - mean).T, (streak_px - shift).T
    spread = float(share @ (u * u + v * v))
    roll = 0.0
    if len(uv) >= 4 and spread > 0:
        roll = float(share @ (u * moved_v - v * moved_u)) / spread
    return Streak(float(shift[0] + roll * (mean[1] - v0)),
                  float(shift[1] - roll * (mean[0] - u0)), roll, u0, v0)
