# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Five stars identified by all ten sides between them: the slow peer of the Hausdorff methods.

Toloei, Zahednamazi, Ghasemi and Mohammadi (2020) compare three such geometric structures; their
shapes are not printed in the paper repeated here. This is the plainest of the family that
Zahednamazi and Toloei describe (Int. J. Eng. Trans. A 31, 2018: four or five stars, V <= 4, a
field of 20 x 20 deg): every set of five catalogue stars that one image can hold, with all its
sides, all of them compared, without an index.
"""

from itertools import combinations

import numpy as np
from startracker_ros.core.maths.rotation import angle_between

STARS = 5
_SIDES = np.array(list(combinations(range(STARS), 2)))
_CHUNK = 20_000


class FiveStarStructures:
    """
    All sets of five catalogue stars closer than an angle, brightest first.

    star (S, 5) are indices into the stars, side (S, 10) the angles in rad between each two.
    """

    def __init__(self, direction: np.ndarray, diameter_rad: float) -> None:
        """Build the sets of stars (N, 3), brightest first, closer than diameter_rad."""
        near = direction @ direction.T >= np.cos(diameter_rad)
        later = np.arange(len(direction))
        star = later[:, None]
        for _ in range(STARS - 1):
            parts = []
            for begin in range(0, len(star), _CHUNK):
                rows = star[begin:begin + _CHUNK]
                fits = near[rows].all(1) & (later > rows[:, -1:])
                row, added = np.nonzero(fits)
                parts.append(np.column_stack([rows[row], added]).astype(np.int16))
            star = np.concatenate(parts)
        self.star = star
        self.side = np.concatenate([_sides(direction[star[begin:begin + _CHUNK]])
                                    for begin in range(0, len(star), _CHUNK)]).astype(np.float32)

    def identify(self, direction: np.ndarray, tolerance_rad: float) -> np.ndarray | None:
        """
        Return the stars (5,) of the five brightest of an image (N, 3), None if not exactly one.

        Every side has to agree within tolerance_rad with the one of the same rank.
        """
        if len(direction) < STARS:
            return None
        seen = _sides(direction[None, :STARS])[0]
        found = np.flatnonzero((np.abs(self.side - seen) <= tolerance_rad).all(1))
        return self.star[found[0]].astype(int) if len(found) == 1 else None


def _sides(corner: np.ndarray) -> np.ndarray:
    """Return the sides (S, 10) in rad of sets (S, 5, 3)."""
    return angle_between(corner[:, _SIDES[:, 0]], corner[:, _SIDES[:, 1]])
