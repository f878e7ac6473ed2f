# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Test for a lens that differs from its model.

With a wrong focal length or distortion a few stars match, and around them the others lie near
catalogue stars, more often than by chance, but not at them. With p the probability of a match
within the radius r, a random star has a near miss within R = 8 r with the probability
p_R = p (R^2 / r^2 - 1); k near misses of n unmatched stars are tested against the binomial tail.

Near misses have another cause where the lens is right: two close stars may be resolved, joined,
or the fainter one missed, otherwise than the catalogue assumes. A near miss of an entry that the
catalogue marks as blended is therefore not counted. The others are weighed by the likelihoods of
the whole field. m matches beyond those of the pattern have residuals d_i of the standard
deviation sigma.

H_0, the lens is right: a share e of the stars is blended and misses its entry, the others have
Gaussian residuals. H_1, the lens is wrong: a share w misses, the others match where the wrong
positions happen to be less than r off, with residuals uniform in the disc. In both cases n p_R
near misses are chance. With s = m + k

    ln (L_0 / L_1) = m ln ((1 - e) / (1 - w) r^2 / (2 sigma^2)) - sum_i d_i^2 / (2 sigma^2)
                     + k ln ((e s + n p_R) / (w s + n p_R)).

The lens is rejected when the near misses are no chance and the ratio is below one.
"""

import numpy as np
from startracker_ros.core.catalog.sky_grid import SkyGrid
from startracker_ros.core.compiled import compiled
from startracker_ros.core.identify.association import contains, nearest_star
from startracker_ros.core.identify.false_alarm import binomial_tail

_NEAR_MISS_RADII = 8.0
# So improbable a number of near misses is not due to chance.
_NEAR_MISS_PROBABILITY = 1e-3
# e: blends without a mark, at most as many as have one: 4 % at 42 arcsec a pixel and V 6.5.
_BLENDED_SHARE = 0.05
# w: less than that of a focal length 1 % off, 0.7, for a cluster that matches as a whole.
_MISSED_SHARE = 0.5


@compiled
def lens_mismatch(sky: SkyGrid, equidistant: bool, blended: np.ndarray, matrix: np.ndarray,
                  seen: np.ndarray, ratio: float, radius: float, sigma: float,
                  matched: np.ndarray, residual: np.ndarray, m: int, p: float) -> bool:
    """
    Return whether the near misses of a field are due to its lens.

    blended (S,) marks catalogue entries; matrix (3, 3) turns sensor vectors to ICRF; seen (N, 2)
    are the undistorted coordinates of the image stars, matched (N,) their catalogue stars, -1 for
    none, residual (N,) their distances; m counts the matches that are evidence; p is the
    probability that a star falls within the radius of an entry by chance.
    """
    n, k = _near_misses(sky, equidistant, blended, matrix, seen, ratio, radius, matched)
    p_miss = min(p * (_NEAR_MISS_RADII ** 2 - 1), 1.0)
    if binomial_tail(k, n, p_miss) >= _NEAR_MISS_PROBABILITY:
        return False
    log_ratio = m * np.log((1 - _BLENDED_SHARE) / (1 - _MISSED_SHARE)
                           * radius ** 2 / (2 * sigma ** 2))
    for d in residual:
        if d >= 0:
            log_ratio -= d ** 2 / (2 * sigma ** 2)
    chance = n * p_miss
    log_ratio += k * np.log((_BLENDED_SHARE * (m + k) + chance)
                            / (_MISSED_SHARE * (m + k) + chance))
    return log_ratio < 0


@compiled
def _near_misses(sky: SkyGrid, equidistant: bool, blended: np.ndarray, matrix: np.ndarray,
                 seen: np.ndarray, ratio: float, radius: float, matched: np.ndarray
                 ) -> tuple[int, int]:
    """Return the number of unmatched image stars, and of those near a single unmatched star."""
    unmatched = near = 0
    for i in range(len(seen)):
        if matched[i] >= 0:
            continue
        unmatched += 1
        star, _ = nearest_star(sky, equidistant, matrix, seen[i, 0] / ratio, seen[i, 1] / ratio,
                               _NEAR_MISS_RADII * radius)
        near += star >= 0 and not blended[star] and not contains(matched, star)
    return unmatched, near
