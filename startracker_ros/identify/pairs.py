"""All pairs of catalogue stars that fit into one image, sorted by separation."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from startracker_ros.catalog.onboard import OnboardCatalog
from startracker_ros.catalog.sky_grid import pairs_within, sky_grid
from startracker_ros.identify.kvector import KVector

# Memory and time to build bound the number of pairs: in wide fields by the faintest stars; in
# narrow ones, whose few stars are all needed, by the longest sides as well.
MOST_PAIRS = 6e6
_NARROW_RAD = np.radians(6.0)
_MOST_NARROW_PAIRS = 1.6e6
_NARROW_STARS_PER_FIELD = 20.0


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
                max_separation_rad: float, most_pairs: float = MOST_PAIRS) -> PairDatabase:
    """
    Return the pairs of stars whose centroids no neighbour disturbs.

    max_separation_rad is the diagonal of the image. Of a deep catalogue the brightest stars are
    used, which make most_pairs at most. A narrow field has _NARROW_STARS_PER_FIELD of them on
    average, and the pairs of the smallest separations, _MOST_NARROW_PAIRS.
    """
    star = np.flatnonzero(~onboard.crowded)
    max_separation_rad = min(max_separation_rad, np.pi)
    # Of S stars spread over the sky, S^2 (1 - cos) / 4 pairs are closer than an angle.
    if max_separation_rad > _NARROW_RAD:
        star = star[:int(np.sqrt(4 * most_pairs / (1 - np.cos(max_separation_rad))))]
    else:
        fields = 4 * np.pi / (max_separation_rad ** 2 / 2)
        star = star[:int(_NARROW_STARS_PER_FIELD * fields)]
        share = 4 * _MOST_NARROW_PAIRS / max(len(star), 1) ** 2
        max_separation_rad = min(max_separation_rad, np.arccos(max(1 - share, -1.0)))
    pairs, square = pairs_within(sky_grid(onboard.direction[star]),
                                 2 * np.sin(max_separation_rad / 2))
    order = np.argsort(square)
    order = order[np.searchsorted(square[order], (2 * np.sin(min_separation_rad / 2)) ** 2):]
    return PairDatabase(star.astype(np.int32), 2 * np.arcsin(np.sqrt(square[order]) / 2),
                        pairs[order, 0], pairs[order, 1])
