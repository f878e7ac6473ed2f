"""
Test for a lens that differs from its model.

With a wrong focal length or distortion a few stars match, and around them the others lie near
catalogue stars, more often than by chance, but not at them. With p the probability of a match
within the radius r, a random star has a near miss within R = 8 r with the probability
p (R^2 / r^2 - 1); k near misses of n unmatched stars are tested against the binomial tail.
"""

import numpy as np
from startracker_ros.catalog.sky_grid import SkyGrid
from startracker_ros.compiled import compiled
from startracker_ros.identify.association import contains, nearest_star
from startracker_ros.identify.false_alarm import binomial_tail

_NEAR_MISS_RADII = 8.0
# So improbable a number of near misses is due to the lens.
_NEAR_MISS_PROBABILITY = 1e-3


@compiled
def lens_mismatch(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float,
                  radius: float, matched: np.ndarray, p: float) -> bool:
    """
    Return whether more image stars miss catalogue stars narrowly than by chance.

    matrix (3, 3) turns sensor vectors to ICRF; seen (N, 2) are x / z, y / z of the image stars
    and matched (N,) their catalogue stars, -1 for none; p is the probability that one
    falls within the radius of a star by chance.
    """
    n, k = _near_misses(sky, matrix, seen, ratio, radius, matched)
    p_miss = min(p * (_NEAR_MISS_RADII ** 2 - 1), 1.0)
    return binomial_tail(k, n, p_miss) < _NEAR_MISS_PROBABILITY


@compiled
def _near_misses(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float, radius: float,
                 matched: np.ndarray) -> tuple[int, int]:
    """Return the number of unmatched image stars, and of those near an unmatched star."""
    unmatched = near = 0
    for i in range(len(seen)):
        if matched[i] >= 0:
            continue
        unmatched += 1
        star, _ = nearest_star(sky, matrix, seen[i, 0] / ratio, seen[i, 1] / ratio,
                               _NEAR_MISS_RADII * radius)
        near += star >= 0 and not contains(matched, star)
    return unmatched, near
