"""The light sources in an image: identity, pixel, magnitude."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SceneStars:
    """
    The light sources in an image, catalogue stars first, brightest first.

    hip (N,) int32, 0 for planets and satellites; uv (N, 2) in px; magnitude (N,) V. Close
    pairs are separate entries whose images blend on the detector.
    """

    hip: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def select(self, index: np.ndarray) -> 'SceneStars':
        """Return the stars of a boolean mask (N,) or of indices."""
        return SceneStars(self.hip[index], self.uv[index], self.magnitude[index])
