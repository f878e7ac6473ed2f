"""
A lens that is not what it is taken for leaves a trace.

Around the few stars that do match, the others lie near catalogue stars, more often than chance
would have it, but not at them.
"""

import numpy as np
from startracker_ros.catalog.sky_grid import SkyGrid
from startracker_ros.compiled import compiled
from startracker_ros.identify.chance import binomial_tail
from startracker_ros.identify.pairing import contains, star_at

# Image stars without a match count as near misses up to so many matching radii from a star;
# so improbable a number of them is the lens, not chance.
_NEAR_MISS_RADII = 8.0
_NEAR_MISS_CHANCE = 1e-3


@compiled
def wrong_lens(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float, radius: float,
               matched: np.ndarray, by_chance: float) -> bool:
    """
    Return whether more image stars miss catalogue stars narrowly than chance would have it.

    matrix (3, 3) turns sensor vectors to ICRF; seen (N, 2) are x / z, y / z of the image stars
    and matched (N,) their catalogue stars, -1 for none; by_chance is the probability that one
    falls within the radius of a star.
    """
    free, near = _near_misses(sky, matrix, seen, ratio, radius, matched)
    near_by_chance = min(by_chance * (_NEAR_MISS_RADII ** 2 - 1), 1.0)
    return binomial_tail(near, free, near_by_chance) < _NEAR_MISS_CHANCE


@compiled
def _near_misses(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float, radius: float,
                 matched: np.ndarray) -> tuple[int, int]:
    """Return how many image stars without a match there are, and how many near a free star."""
    free = near = 0
    for i in range(len(seen)):
        if matched[i] >= 0:
            continue
        free += 1
        star, _ = star_at(sky, matrix, seen[i, 0] / ratio, seen[i, 1] / ratio,
                          _NEAR_MISS_RADII * radius)
        near += star >= 0 and not contains(matched, star)
    return free, near
