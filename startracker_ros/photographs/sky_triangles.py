# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Triangles of the sky by their shape, for fields of about one size.

native/src/blind/sky_triangle.h tells what the code of a triangle is. One of an image whose scale
is known to some percent is looked up in a fraction of a microsecond.

The stars are the brightest ones of each part of the sky: a field at a pole of the Galaxy has as
many as one in the Milky Way.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import pairs_within, sky_grid
from startracker_ros.core.stored_arrays import digest, stored_arrays, StoredArrays

# A star of a triangle is among so many brightest in the disc about it of the area of an image.
_BRIGHTEST = 11
# Sides as a share of the side of a square of that area: shorter ones help little against the
# noise; most triangles of an image have no longer ones.
_SHORTEST, _LEAST_LONGEST, _LONGEST = 0.06, 0.2, 0.85
# Such stars about each one, which are looked for around a triangle of it.
_NEIGHBOURS = 32
_CELLS = 40  # of the codes along each axis: ST_TRIANGLE_CELLS


class TriangleTable(NamedTuple):
    """
    Triangles in the order of the cells of their codes, then of d_0.

    side (T, 3) float32 are d_0, d_1, d_2 in rad, star (T, 3) int32 the stars opposite; those of
    cell c are start[c] to start[c + 1]. neighbour (S, K) int32 are the bright stars about each
    one, -1 where there are fewer. low and high are the bounds of d_0 in rad.
    """

    side: np.ndarray
    star: np.ndarray
    start: np.ndarray
    neighbour: np.ndarray
    low: float
    high: float

    def native(self) -> np.ndarray:
        """Return the st_triangle_table of these arrays, which have to stay."""
        return np.array((*(array.ctypes.data for array in (
            self.side, self.star, self.start, self.neighbour)), self.low, self.high,
            self.neighbour.shape[1], 0), native.TRIANGLE_TABLE)


class SkyTriangles(NamedTuple):
    """A table, and the arrays in the cache that it is mapped from."""

    table: TriangleTable
    stored: StoredArrays


def sky_triangles(onboard: OnboardCatalog, area: float) -> SkyTriangles:
    """Return the triangles in images of an area in rad^2, from the cache or built."""
    edge = float(np.sqrt(area))

    def build() -> dict[str, np.ndarray]:
        return _build(onboard, edge)
    stored = stored_arrays('triangles', digest(
        onboard.digest, edge, _BRIGHTEST, _NEIGHBOURS), build)
    return SkyTriangles(TriangleTable(**stored.arrays, low=_LEAST_LONGEST * edge,
                                      high=_LONGEST * edge), stored)


def _build(onboard: OnboardCatalog, edge: float) -> dict[str, np.ndarray]:
    """Return the arrays of a table of images of an area of edge^2."""
    longest = 2 * np.sin(_LONGEST * edge / 2)
    pairs, square = pairs_within(sky_grid(onboard.direction), longest)
    # The first star of a pair is the brighter one.
    brighter = np.bincount(pairs[square <= edge ** 2 / np.pi, 1], minlength=len(onboard))
    chosen = brighter < _BRIGHTEST
    pairs = pairs[chosen[pairs].all(1)]
    sides = pairs[~onboard.crowded[pairs].any(1)]
    sides = sides[np.lexsort((sides[:, 1], sides[:, 0]))]
    start = np.searchsorted(sides[:, 0], np.arange(len(onboard) + 1))
    side, star, cell = _triangles(onboard.direction, sides[:, 1].copy(), start,
                                  _SHORTEST * edge, _LEAST_LONGEST * edge, _LONGEST * edge)
    order = np.lexsort((side[:, 0], cell))
    first = np.zeros(2 * _CELLS ** 2 + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=2 * _CELLS ** 2), out=first[1:])
    return {'side': side[order], 'star': star[order], 'start': first,
            'neighbour': _neighbours(pairs, brighter)}


def _neighbours(pairs: np.ndarray, brighter: np.ndarray) -> np.ndarray:
    """Return the partners (S, K) of stars in pairs (P, 2), those with fewest brighter first."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort((brighter[both[:, 1]], both[:, 0]))]
    rank = np.arange(len(both)) - np.searchsorted(both[:, 0], both[:, 0])
    neighbour = np.full((len(brighter), _NEIGHBOURS), -1, np.int32)
    kept = rank < _NEIGHBOURS
    neighbour[both[kept, 0], rank[kept]] = both[kept, 1]
    return neighbour


def _triangles(direction: np.ndarray, partner: np.ndarray, start: np.ndarray, shortest: float,
               least_longest: float, longest: float) -> tuple[np.ndarray, ...]:
    """
    Return sides (T, 3), stars (T, 3) and cells (T,) of all triangles of the sky.

    partner and start hold the fainter stars that make sides with each star of direction (N, 3).
    """
    given = (np.ascontiguousarray(direction, float), len(direction),
             *(np.ascontiguousarray(array, np.int32) for array in (partner, start)),
             shortest, least_longest, longest)
    count = np.zeros(1, np.uintp)
    native.call('st_make_triangles', *given, None, None, None, count)
    side, star = np.empty((count[0], 3), np.float32), np.empty((count[0], 3), np.int32)
    cell = np.empty(count[0], np.int32)
    native.call('st_make_triangles', *given, side, star, cell, count)
    return side, star, cell
