# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where stars and targets will be: what a star tracker expects of the next image."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.centroid.streak import fit_streak, Streak


@dataclass(frozen=True)
class PredictedCentroids:
    """
    Centroids expected in an image at the time stamp_ns: stars, brightest first, then targets.

    uv (N, 2) px with the error sigma_px (N,) per axis, of a target that in the next image;
    velocity (N, 2) px/s; hip (N,), 0 for a target; stars is the number of stars.
    """

    stamp_ns: int
    uv: np.ndarray
    velocity: np.ndarray
    sigma_px: np.ndarray
    hip: np.ndarray
    stars: int

    def joined(self, targets: 'PredictedCentroids') -> 'PredictedCentroids':
        """Return these centroids followed by targets at the same time."""
        return PredictedCentroids(
            self.stamp_ns, np.concatenate([self.uv, targets.uv]),
            np.concatenate([self.velocity, targets.velocity]),
            np.concatenate([self.sigma_px, targets.sigma_px]),
            np.concatenate([self.hip, targets.hip]), self.stars)

    def in_cells(self, cell: int) -> 'PredictedCentroids':
        """Return them in the pixels of an image of which each is cell x cell of the camera."""
        if cell == 1:
            return self
        return replace(self, uv=(self.uv - (cell - 1) / 2) / cell, velocity=self.velocity / cell,
                       sigma_px=self.sigma_px / cell)

    def motion(self, shape: tuple[int, int]) -> Streak:
        """Return the motion of the stars in a second over an image of this shape (H, W)."""
        stars = slice(self.stars)
        return fit_streak(self.uv[stars], self.velocity[stars], np.ones(self.stars), shape)
