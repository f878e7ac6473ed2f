"""Where stars will be: what a star tracker expects of the next image."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.centroid.streak import fit_streak, Streak


@dataclass(frozen=True)
class PredictedStars:
    """
    Stars expected in an image, brightest first, at the time stamp_ns.

    uv (N, 2) px with the error sigma_px (N,) per axis; velocity (N, 2) px/s; hip (N,).
    """

    stamp_ns: int
    uv: np.ndarray
    velocity: np.ndarray
    sigma_px: np.ndarray
    hip: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def at(self, stamp_ns: int) -> np.ndarray:
        """Return the positions (N, 2) in px at another time."""
        return self.uv + self.velocity * ((stamp_ns - self.stamp_ns) * 1e-9)

    def motion(self, shape: tuple[int, int]) -> Streak:
        """Return the motion in a second over an image of this shape (H, W)."""
        return fit_streak(self.uv, self.velocity, np.ones(len(self)), shape)
