"""Which stars fall into the image, and where."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SceneStars:
    """
    What shines in an image, catalogue stars first, brightest first.

    hip (N,) int32, 0 for planets and satellites; uv (N, 2) in px; magnitude (N,) V. Close
    pairs stay apart: their images blend on the detector as they do in the sky.
    """

    hip: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        """Return the number of stars."""
        return len(self.hip)

    def select(self, chosen: np.ndarray) -> 'SceneStars':
        """Return the stars of a boolean mask (N,) or of indices."""
        return SceneStars(self.hip[chosen], self.uv[chosen], self.magnitude[chosen])
