# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where stars and targets will be: what a star tracker expects of the next image."""

from dataclasses import dataclass

import numpy as np


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

    @classmethod
    def none(cls, stamp_ns: int) -> 'PredictedCentroids':
        """Return that no centroid is expected."""
        return cls(stamp_ns, np.empty((0, 2)), np.empty((0, 2)), np.empty(0),
                   np.empty(0, np.int32), 0)

    def joined(self, targets: 'PredictedCentroids') -> 'PredictedCentroids':
        """Return these centroids followed by targets at the same time."""
        return PredictedCentroids(
            self.stamp_ns, np.concatenate([self.uv, targets.uv]),
            np.concatenate([self.velocity, targets.velocity]),
            np.concatenate([self.sigma_px, targets.sigma_px]),
            np.concatenate([self.hip, targets.hip]), self.stars)
