# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All pairs of catalogue stars that fit into one image, sorted by separation."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import pairs_within, sky_grid
from startracker_ros.core.stored_arrays import StoredArrays

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

    star (S,) int32 are catalogue indices, direction (S, 3) unit vectors. Pair p has the
    separation (P,) float64 in rad, ascending, and the stars member[2 p], member[2 p + 1] (2 P,)
    int32, indices into star. below (P + 1,) is that of steps_below(); previous[e] (2 P,) the entry
    of member before e of the same star, -1 for none. stored is where the arrays are mapped from.
    """

    star: np.ndarray
    direction: np.ndarray
    separation: np.ndarray
    below: np.ndarray
    member: np.ndarray
    previous: np.ndarray
    stored: StoredArrays | None = None

    @property
    def first(self) -> np.ndarray:
        """Return the first star (P,) of each pair."""
        return self.member[::2]

    @property
    def second(self) -> np.ndarray:
        """Return the second star (P,) of each pair."""
        return self.member[1::2]

    def among(self, count: int) -> 'PairDatabase':
        """Return the pairs of the count brightest stars alone."""
        chosen = (self.first < count) & (self.second < count)
        return _database(self.star[:count], self.direction[:count], self.separation[chosen],
                         self.member.reshape(-1, 2)[chosen])

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs of a separation in both orders: stars a (M,) and b (M,)."""
        found = slice(np.searchsorted(self.separation, low_rad),
                      np.searchsorted(self.separation, high_rad, 'right'))
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
    return _database(star.astype(np.int32), onboard.direction[star],
                     2 * np.arcsin(np.sqrt(square[order]) / 2), pairs[order])


def _database(star: np.ndarray, direction: np.ndarray, separation: np.ndarray,
              pairs: np.ndarray) -> PairDatabase:
    """Return the database of stars (S,) and pairs (P, 2) of them by separation (P,)."""
    member = pairs.ravel()
    return PairDatabase(star, direction, separation, steps_below(separation), member,
                        _previous_entries(member, len(star)))


def steps_below(values: np.ndarray) -> np.ndarray:
    """
    Return the k-vector (N + 1,) of sorted values (N,) (Mortari and Neta 2000).

    The line z(i), from the first value to the last in N steps, and the number below[i] of values
    under z(i) (Yuan, Zhang, Shi 2017, section 2). native/src/sky/queries.cpp searches with it.
    """
    count = len(values)
    start, last = values[[0, -1]] if count else (0.0, 0.0)
    step = (last - start) / count if last > start else 1.0
    below = np.searchsorted(values, start + step * np.arange(count + 1)).astype(np.int32)
    below[-1] = count
    return below


def _previous_entries(member: np.ndarray, stars: int) -> np.ndarray:
    """Return the entry (2 P,) before each one of the same star, of member (2 P,), -1 for none."""
    # Takes long to import, and is needed where pairs are built.
    from scipy.sparse import csr_array
    count = len(member)
    by_entry = csr_array((np.ones(count, np.int8), member, np.arange(count + 1, dtype=np.int32)),
                         shape=(count, stars))
    by_star = by_entry.tocsc()
    previous = np.full_like(member, -1)
    previous[by_star.indices[1:]] = by_star.indices[:-1]
    # The first entry of each star has none before.
    begin = by_star.indptr[:-1][np.diff(by_star.indptr) > 0]
    previous[by_star.indices[begin]] = -1
    return previous
