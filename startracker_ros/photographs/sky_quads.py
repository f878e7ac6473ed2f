# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Quads of stars by their shape, whatever the scale of the image.

Lang, Hogg, Mierle, Blanton, Roweis 2010, Astrometry.net; native/src/blind/quads.h tells what the
code of four stars A, B, C, D is. Differences from the paper: C and D may be anywhere nearer to A
and B than these are to each other, so that any four stars are a quad; codes are on the sphere, so
that wide fields have them too; they are looked up in the cells of a grid, not in a tree.

The sky is covered by levels. That of the side d has the brightest stars, so many in d^2 on
average, and quads whose longest side is d to sqrt(2) d. For narrow fields, whose density differs
by an order of magnitude, these are the brightest stars of each cell of the sky: a field at the
galactic pole then has as many quads as one in the Milky Way.
"""

from collections.abc import Iterator
from functools import cache
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, sky_angles, sky_grid, sorted_by_cell)
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.stored_arrays import digest, stored_arrays, StoredArrays

_STEP = np.sqrt(2)
# A star this close to a brighter one, as a share of the side, is in no quad: it is blended.
_CROWD = 1 / 60
# Of the stars between A and B the brightest.
_INNER = 4
FEWEST_STARS = 150
_PIECE = 1 << 19  # quads that are made at once
# Cells of the codes along x, 0 to 1, and along y, -1 to 1: as ST_QUAD_CELLS.
_CELLS_X, _CELLS_Y = 26, 52
CODE_CELLS = (_CELLS_X * _CELLS_Y) ** 2


class QuadTable(NamedTuple):
    """
    Quads in the order of the cells of their codes.

    code (Q, 4) float32; star (Q, 4) int32 rows of the catalogue, A to D; side (Q,) float32 of A B
    in rad; those of cell c are start[c] to start[c + 1].
    """

    code: np.ndarray
    star: np.ndarray
    side: np.ndarray
    start: np.ndarray


class SkyQuads(NamedTuple):
    """A table, and the arrays in the cache that it is mapped from."""

    table: QuadTable
    stored: StoredArrays


def sky_quads(catalog: StarCatalog, epoch_year: float, least_deg: float, most_deg: float,
              density: float, *, even: bool = False) -> SkyQuads:
    """
    Return the quads of longest sides from least to most, from the cache or built.

    A level has density stars in the square of its side; even has as many everywhere.
    """
    def build() -> dict[str, np.ndarray]:
        return quad_table(*quads_of(catalog.directions(epoch_year), least_deg, most_deg, density,
                                    even=even))._asdict()
    stored = stored_arrays('quads', digest(
        catalog.digest, epoch_year, least_deg, most_deg, density, even), build)
    return SkyQuads(QuadTable(**stored.arrays), stored)


def quads_of(direction: np.ndarray, least_deg: float, most_deg: float, density: float, *,
             even: bool = False, inner: int = _INNER, sky_share: float = 1.0
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return codes, stars and sides of the quads of stars (N, 3), brightest first.

    Arguments are those of sky_quads(); inner is from how many stars C and D are, sky_share what
    the stars cover.
    """
    parts = [(np.empty((0, 4), np.float32), np.empty((0, 4), np.int32), np.empty(0, np.float32))]
    angles = sky_angles(direction) if even else np.empty((2, 0))
    for side_rad in np.radians(level_sides_deg(least_deg, most_deg)) if len(direction) else ():
        if even:
            bright = np.flatnonzero(brightest_everywhere(angles, density / side_rad ** 2))
        else:
            bright = np.arange(max(int(density * 4 * np.pi / side_rad ** 2), FEWEST_STARS))
            bright = bright[:len(direction)]
        stars = bright.astype(np.int32)
        parts += ((code, stars[quad], side) for code, quad, side in _level(
            direction[bright], side_rad, inner, sky_share))
    code, quad, side = (np.concatenate(columns) for columns in zip(*parts))
    return code, quad, side


def level_sides_deg(least_deg: float, most_deg: float) -> list[float]:
    """Return the side of each level."""
    sides, side_deg = list[float](), least_deg
    while side_deg < most_deg * 0.999:
        sides.append(side_deg)
        side_deg *= _STEP
    return sides


def quad_table(code: np.ndarray, quad: np.ndarray, side: np.ndarray) -> QuadTable:
    """Return the table of quads in any order."""
    start, order = sorted_by_cell(code_cells(code), CODE_CELLS)
    code, quad, side = (np.take(column, order, 0) for column in (code, quad, side))
    return QuadTable(code, quad, side, start)


def _level(direction: np.ndarray, side_rad: float, inner: int, sky_share: float
           ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield codes, stars and sides of the quads of a level, in pieces."""
    grid, count = sky_grid(direction, sky_share), len(direction)
    longest, in_cells = min(_STEP * side_rad, np.pi / 2), grid.direction[grid.member]
    level = np.array((
        *(array.ctypes.data for array in (in_cells, grid.start, grid.member)),
        *(2 * np.sin(angle / 2) for angle in (side_rad, longest, _CROWD * side_rad)),
        count, grid.cells, inner, 0), native.QUAD_LEVEL)
    work = [np.empty(count, kind) for kind in (np.int32, np.int64, float, bool)]
    done = np.zeros(1, np.uintp)
    while done[0] < count:
        code, quad = np.empty((_PIECE, 4), np.float32), np.empty((_PIECE, 4), np.int32)
        side, found = np.empty(_PIECE, np.float32), np.array([_PIECE], np.uintp)
        native.call('st_make_quads', level, *work, done, code, quad, side, found)
        made = slice(int(found[0]))
        yield code[made], quad[made], side[made]


def code_cells(code: np.ndarray) -> np.ndarray:
    """Return the cell (Q,) of each code (Q, 4) float32."""
    cell = np.empty(len(code), np.int32)
    native.call('st_quad_cells', np.ascontiguousarray(code), len(code), cell)
    return cell


_MOST_IMAGE_STARS = 30
_MOST_REVERSED = 3  # of the six pairs of a quad


@cache
def _all_quads() -> np.ndarray:
    """Return all quads (Q, 4) of the first image stars, in the order of their last stars."""
    quads = np.array([*combinations(range(_MOST_IMAGE_STARS), 4)], np.int32)
    return quads[np.lexsort(quads.T)]


def matching_quads(table: QuadTable, direction: np.ndarray, first: int, last: int,
                   tolerance: float, low: float, high: float, most: int
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the quads of the sky that have the code of a quad of image stars, within tolerance.

    The image stars are those of image_quads(). For the rest see matching_neighbours().
    """
    return matching_neighbours(table, direction, image_quads(len(direction), first, last),
                               tolerance, low, high, most)


def image_quads(count: int, first: int, last: int) -> np.ndarray:
    """Return the quads (Q, 4) of 30 of count stars at most, their last one first to last - 1."""
    return _all_quads()[comb(first, 4):comb(min(last, count, _MOST_IMAGE_STARS), 4)]


def depths(uv: np.ndarray, quads: np.ndarray, area: float) -> np.ndarray:
    """
    Return how many stars as bright as those of a quad (Q, 4) the square of its longest side has.

    uv (N, 2) are the spots of an image of this area, brightest first: the number of the last star
    times the share of the image. A level of a table has quads of stars up to a depth.
    """
    square = ((uv[:, None] - uv) ** 2).sum(axis=2)
    longest = np.max([square[quads[:, a], quads[:, b]] for a, b in combinations(range(4), 2)],
                     axis=0, initial=0.0)
    return (quads[:, 3] + 1) * longest / area


def in_order(image: np.ndarray, star: np.ndarray) -> np.ndarray:
    """
    Return whether stars (K, 4) of the sky and of an image are mostly in the same order (K,).

    Both are numbers by brightness. Of the true stars of a quad that is nearly always so; of others
    three eighths have more pairs reversed than not, and need no further look.
    """
    reversed_pairs = sum(((image[:, a] < image[:, b]) != (star[:, a] < star[:, b])).astype(int)
                         for a, b in combinations(range(4), 2))
    return np.asarray(reversed_pairs <= _MOST_REVERSED)


def matching_neighbours(table: QuadTable, direction: np.ndarray, quads: np.ndarray,
                        tolerance: float, low: float, high: float, most: int
                        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the quads of the sky that have the code of one of quads (Q, 4), within tolerance.

    They are of image stars of direction (N, 3); those with a star that has no direction, NaN, are
    left out. The side of the sky is low to high times that of the image. Return stars of the image
    (K, 4), rows of the table (K,) and ratios (K,) of the sides, of most quads at most.
    """
    arrays = [np.ascontiguousarray(array, kind) for array, kind in (
        (table.code, np.float32), (table.side, np.float32), (table.start, np.int32),
        (direction, float), (quads, np.int32))]
    sky = np.array(tuple(array.ctypes.data for array in arrays[:3]), native.QUAD_TABLE)
    image, row, ratio = np.empty((most, 4), np.int32), np.empty(most, np.int32), np.empty(most)
    count = np.array([most], np.uintp)
    native.call('st_match_quads', sky, arrays[3], len(direction), arrays[4], len(quads), tolerance,
                low, high, image, row, ratio, count)
    found = slice(int(count[0]))
    return image[found].copy(), row[found].astype(int), ratio[found].copy()
