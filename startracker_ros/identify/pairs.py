"""All pairs of catalogue stars that fit into one image, sorted by separation."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from startracker_ros.catalog.onboard import OnboardCatalog
from startracker_ros.identify.kvector import KVector

# 100 MB, and some two seconds to build.
_MOST_PAIRS = 6e6


@dataclass(frozen=True)
class PairDatabase:
    """
    Star pairs by angular separation.

    star (S,) int32 are catalogue indices; separation (P,) float64 rad ascending; first, second
    (P,) int32 are indices into star.
    """

    star: np.ndarray
    separation: np.ndarray
    first: np.ndarray
    second: np.ndarray

    @cached_property
    def kvector(self) -> KVector:
        """Return the range search over the separations."""
        return KVector(self.separation)

    def among(self, count: int) -> 'PairDatabase':
        """Return the pairs of the count brightest stars alone."""
        chosen = (self.first < count) & (self.second < count)
        return PairDatabase(self.star[:count], self.separation[chosen],
                            self.first[chosen], self.second[chosen])

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs of a separation in both orders: stars a (M,) and b (M,)."""
        found = self.kvector.between(low_rad, high_rad)
        first, second = self.first[found], self.second[found]
        return np.concatenate([first, second]), np.concatenate([second, first])


def build_pairs(onboard: OnboardCatalog, min_separation_rad: float,
                max_separation_rad: float) -> PairDatabase:
    """
    Return all pairs of stars whose centroids no neighbour disturbs.

    A deep catalogue and a wide field make too many pairs for the memory: the brightest stars
    then make _MOST_PAIRS at most.
    """
    # Of S stars spread over the sky, S^2 (1 - cos) / 4 pairs are closer than an angle.
    most = int(np.sqrt(4 * _MOST_PAIRS / max(1 - np.cos(max_separation_rad), 1e-12)))
    star = np.flatnonzero(~onboard.crowded)[:most]
    direction = onboard.direction[star]
    # Imported here: a cached database needs no tree, whose import is slow.
    from scipy.spatial import cKDTree
    pairs = cKDTree(direction).query_pairs(2 * np.sin(max_separation_rad / 2),
                                           output_type='ndarray')
    chord = np.linalg.norm(direction[pairs[:, 0]] - direction[pairs[:, 1]], axis=1)
    separation = 2 * np.arcsin(chord / 2)
    wide = separation >= min_separation_rad
    pairs, separation = pairs[wide], separation[wide]
    order = np.argsort(separation)
    return PairDatabase(star.astype(np.int32), separation[order],
                        pairs[order, 0].astype(np.int32), pairs[order, 1].astype(np.int32))
