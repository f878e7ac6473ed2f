# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Triangles of the sky by their shape, for fields of about one size.

The sides of a triangle are d_0 >= d_1 >= d_2, its stars A, B, C those opposite. Its code is
(d_2 / d_0, d_1 / d_0) and the sign of A . (B x C); codes are looked up in the cells of a grid, in
each of which the triangles are in the order of d_0. So a triangle of an image whose scale is known
to some percent is looked up in a fraction of a microsecond.

The stars are the brightest ones of each part of the sky: a field at a pole of the Galaxy has as
many as one in the Milky Way.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import pairs_within, sky_grid
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.stored_arrays import digest, stored_arrays, StoredArrays
from startracker_ros.photographs.support import squared_chord, triple_product

# A star of a triangle is among so many brightest in the disc about it of the area of an image.
_BRIGHTEST = 11
# Sides as a share of the side of a square of that area: shorter ones are of little use beside the
# noise; most triangles of an image have no longer ones.
_SHORTEST, _LEAST_LONGEST, _LONGEST = 0.06, 0.2, 0.85
# Where d_1 + d_2 is hardly more than d_0, noise turns a triangle over.
FLATTEST = 1.02
# Such stars about each one, which are looked for around a triangle of it.
_NEIGHBOURS = 32
_CELLS = 40  # of the codes along each axis


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
                                  _SHORTEST * edge, _LEAST_LONGEST * edge, longest ** 2)
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


@inlined
def cell_along(ratio: float) -> int:
    """Return the cell along its axis of a ratio of sides."""
    return min(max(int(ratio * _CELLS), 0), _CELLS - 1)


@inlined
def code_cell(shortest: int, middle: int, turned: bool) -> int:
    """Return the number of a cell from those along both axes and the sign of A . (B x C)."""
    return ((_CELLS if turned else 0) + shortest) * _CELLS + middle


@inlined
def side_order(d_a: float, d_b: float, d_c: float) -> tuple[int, int, int]:
    """Return which of three sides are d_0, d_1 and d_2."""
    if d_a >= d_b:
        if d_b >= d_c:
            return 0, 1, 2
        return (0, 2, 1) if d_a >= d_c else (2, 0, 1)
    if d_a >= d_c:
        return 1, 0, 2
    return (1, 2, 0) if d_b >= d_c else (2, 1, 0)


@compiled
def _triangles(direction: np.ndarray, partner: np.ndarray, start: np.ndarray, shortest: float,
               least_longest: float, most_square: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return sides (T, 3), stars (T, 3) and cells (T,) of all triangles of the sky.

    partner and start hold the fainter stars that make sides with each star of direction (N, 3).
    """
    count = 0
    side, star = np.empty((0, 3), np.float32), np.empty((0, 3), np.int32)
    cell = np.empty(0, np.int64)
    angle, three = np.empty(3), np.empty(3, np.int64)
    # The second pass stores what the first one has counted.
    for stored in range(2):
        if stored:
            side, star = np.empty((count, 3), np.float32), np.empty((count, 3), np.int32)
            cell = np.empty(count, np.int64)
        count = 0
        for a in range(len(start) - 1):
            for m in range(start[a], start[a + 1]):
                for n in range(start[a], m):
                    b, c = partner[n], partner[m]
                    square = squared_chord(direction, b, c)
                    if square > most_square:
                        continue
                    angle[0] = 2 * np.arcsin(np.sqrt(square) / 2)
                    angle[1] = 2 * np.arcsin(np.sqrt(squared_chord(direction, a, c)) / 2)
                    angle[2] = 2 * np.arcsin(np.sqrt(squared_chord(direction, a, b)) / 2)
                    three[0], three[1], three[2] = a, b, c
                    first, second, third = side_order(angle[0], angle[1], angle[2])
                    longest = angle[first]
                    if (longest < least_longest or angle[third] < shortest
                            or angle[second] + angle[third] < FLATTEST * longest):
                        continue
                    if stored:
                        turned = triple_product(direction, three[first], three[second],
                                                three[third]) < 0
                        side[count, 0], star[count, 0] = longest, three[first]
                        side[count, 1], star[count, 1] = angle[second], three[second]
                        side[count, 2], star[count, 2] = angle[third], three[third]
                        cell[count] = code_cell(cell_along(angle[third] / longest),
                                                cell_along(angle[second] / longest), turned)
                    count += 1
    return side, star, cell
