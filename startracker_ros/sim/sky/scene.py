# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The light sources in an image: identity, pixel, magnitude."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SceneStars:
    """
    The light sources in an image, catalogue stars first, brightest first.

    hip (N,) int32, 0 for planets, satellites and false stars; uv (N, 2) in px; magnitude (N,)
    V. Close pairs are separate entries whose images blend on the detector.
    """

    hip: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def select(self, index: np.ndarray) -> 'SceneStars':
        """Return the stars of a boolean mask (N,) or of indices."""
        return SceneStars(self.hip[index], self.uv[index], self.magnitude[index])

    def joined(self, other: 'SceneStars') -> 'SceneStars':
        """Return these stars and those of another scene."""
        return SceneStars(np.append(self.hip, other.hip), np.vstack([self.uv, other.uv]),
                          np.append(self.magnitude, other.magnitude))


def false_stars(uv: np.ndarray, magnitude: np.ndarray) -> SceneStars:
    """Return sources at uv (N, 2) px of V magnitude (N,) that are no catalogue stars."""
    return SceneStars(np.zeros(len(uv), np.int32), uv, magnitude)
