# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Quads of stars by their shape, whatever the scale of the image.

Lang, Hogg, Mierle, Blanton, Roweis 2010, Astrometry.net. Four stars A, B, C, D, of which A and B
are the farthest apart, are put on the stereographic plane that touches the sphere in the middle of
A and B, turned and scaled so that A is (0, 0) and B is (1, 0). The code of the quad is
(x_C, y_C, x_D, y_D), with x_C + x_D <= 1 and x_C <= x_D, which tell A from B and C from D.

Differences from the paper: C and D may be anywhere nearer to A and B than these are to each other,
so that any four stars are a quad; codes are on the sphere, so that wide fields have them too; they
are looked up in the cells of a grid, not in a tree.

The sky is covered by levels. That of the side d has the brightest stars, so many in d^2 on
average, and quads whose longest side is d to sqrt(2) d. For narrow fields, whose density differs
by an order of magnitude, these are the brightest stars of each cell of the sky: a field at the
galactic pole then has as many quads as one in the Milky Way.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, pairs_within, sky_grid)
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.stored_arrays import digest, stored_arrays, StoredArrays
from startracker_ros.photographs.support import squared_chord

_STEP = np.sqrt(2)
# A star this close to a brighter one, as a share of the side, is in no quad: it is blended.
_CROWD = 1 / 60
# Of the stars between A and B the brightest.
_INNER = 4
_FEWEST_STARS = 150
# Cells of the codes along x, 0 to 1, and along y, -1 to 1.
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
    for side_rad in np.radians(level_sides_deg(least_deg, most_deg)) if len(direction) else ():
        if even:
            bright = brightest_everywhere(direction, density / side_rad ** 2)
        else:
            bright = np.arange(max(int(density * 4 * np.pi / side_rad ** 2), _FEWEST_STARS))
            bright = bright[:len(direction)]
        parts.append(_level(direction, bright, side_rad, inner, sky_share))
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
    cell = code_cells(code)
    order = np.argsort(cell, kind='stable')
    start = np.zeros(CODE_CELLS + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=len(start) - 1), out=start[1:])
    return QuadTable(code[order], quad[order], side[order], start)


def _level(direction: np.ndarray, star: np.ndarray, side_rad: float, inner: int,
           sky_share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return codes, stars and sides of the quads of a level."""
    longest = min(_STEP * side_rad, np.pi / 2)
    pairs, square = pairs_within(sky_grid(direction[star], sky_share),
                                 2 * np.sin(longest / 2))
    # Without those that have a brighter star close to them.
    alone = np.ones(len(star), bool)
    alone[pairs[square <= (2 * np.sin(_CROWD * side_rad / 2)) ** 2, 1]] = False
    kept = alone[pairs].all(1)
    pairs, square = pairs[kept], square[kept]
    # Neighbours of each star, brightest first.
    # A star and its neighbour as one number: sorted faster than in two columns.
    first, second = pairs.T.astype(np.int64)
    both = np.sort(np.concatenate([first << 32 | second, second << 32 | first]))
    start = np.searchsorted(both, np.arange(len(star) + 1) << 32)
    long = pairs[square >= (2 * np.sin(side_rad / 2)) ** 2]
    neighbour = (both & 0xFFFFFFFF).astype(np.int32)
    code, quad, side = _quads(direction[star], long, neighbour, start, inner)
    return code, star.astype(np.int32)[quad], side


@compiled
def _quads(direction: np.ndarray, long: np.ndarray, neighbour: np.ndarray, start: np.ndarray,
           most_inner: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return codes, stars and sides of the quads of the pairs long (P, 2)."""
    most = len(long) * (most_inner * (most_inner - 1) // 2)
    code, quad = np.empty((most, 4), np.float32), np.empty((most, 4), np.int32)
    side = np.empty(most, np.float32)
    inner, four, one = np.empty(most_inner, np.int64), np.empty(4, np.int64), np.empty(4)
    count = 0
    for p in range(len(long)):
        a, b = long[p, 0], long[p, 1]
        limit = squared_chord(direction, a, b)
        found = 0
        for m in range(start[a], start[a + 1]):
            c = neighbour[m]
            if squared_chord(direction, a, c) < limit and squared_chord(direction, b, c) < limit:
                inner[found] = c
                found += 1
                if found == most_inner:
                    break
        for i in range(found):
            for j in range(i):
                if squared_chord(direction, inner[i], inner[j]) >= limit:
                    continue
                for order in range(4):
                    four[order & 1], four[1 - (order & 1)] = a, b
                    four[2 + order // 2], four[3 - order // 2] = inner[j], inner[i]
                    if quad_code(direction, four, one) and _in_order(one, 0.0):
                        for k in range(4):
                            code[count, k], quad[count, k] = one[k], four[k]
                        side[count] = 2 * np.arcsin(np.sqrt(limit) / 2)
                        count += 1
                        break
    return code[:count].copy(), quad[:count].copy(), side[:count].copy()


@compiled
def quad_code(direction: np.ndarray, four: np.ndarray, code: np.ndarray) -> bool:
    """
    Put the code of stars A, B, C, D = four (4,) of unit vectors (N, 3) into code (4,).

    In the order that they have. False for stars without a code.
    """
    a, b = four[0], four[1]
    mx, my, mz = (direction[a, 0] + direction[b, 0], direction[a, 1] + direction[b, 1],
                  direction[a, 2] + direction[b, 2])
    ex, ey, ez = (direction[b, 0] - direction[a, 0], direction[b, 1] - direction[a, 1],
                  direction[b, 2] - direction[a, 2])
    m, e = np.sqrt(mx * mx + my * my + mz * mz), np.sqrt(ex * ex + ey * ey + ez * ez)
    if not (m > 0 and e > 0):
        return False
    mx, my, mz, ex, ey, ez = mx / m, my / m, mz / m, ex / e, ey / e, ez / e
    # The axis of y is at right angles to A B.
    nx, ny, nz = my * ez - mz * ey, mz * ex - mx * ez, mx * ey - my * ex
    length = e / (1 + m / 2)
    for k in range(2):
        s = four[2 + k]
        x, y, z = direction[s, 0], direction[s, 1], direction[s, 2]
        scale = 1 / ((1 + x * mx + y * my + z * mz) * length)
        code[2 * k] = 0.5 + scale * (x * ex + y * ey + z * ez)
        code[2 * k + 1] = scale * (x * nx + y * ny + z * nz)
    return True


@inlined
def _in_order(code: np.ndarray, tolerance: float) -> bool:
    """Return whether noise of a tolerance lets a code be that of the order of its stars."""
    return code[0] + code[2] <= 1 + 2 * tolerance and code[0] <= code[2] + 2 * tolerance


@inlined
def _cell_x(x: float) -> int:
    return min(max(int(np.floor(x * _CELLS_X)), 0), _CELLS_X - 1)


@inlined
def _cell_y(y: float) -> int:
    return min(max(int(np.floor((y + 1) / 2 * _CELLS_Y)), 0), _CELLS_Y - 1)


@compiled
def code_cells(code: np.ndarray) -> np.ndarray:
    """Return the cell (Q,) of each code (Q, 4)."""
    cell = np.empty(len(code), np.int64)
    for q in range(len(code)):
        cell[q] = (((_cell_x(code[q, 0]) * _CELLS_X + _cell_x(code[q, 2])) * _CELLS_Y
                    + _cell_y(code[q, 1])) * _CELLS_Y + _cell_y(code[q, 3]))
    return cell


@compiled
def matching_quads(table: QuadTable, direction: np.ndarray, first: int, last: int,
                   tolerance: float, low: float, high: float, most: int
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the quads of the sky that have the code of a quad of image stars, within tolerance.

    The image stars are the first ones of direction (N, 3), unit vectors; the last one of a quad is
    first to last - 1. The side of the sky is low to high times that of the image. Return stars of
    the image (K, 4), rows of the table (K,) and ratios (K,) of the sides, of most quads at most.
    """
    found = np.empty((most, 4), np.int32), np.empty(most, np.int64), np.empty(most)
    stars, count = np.empty(4, np.int64), 0
    for i in range(max(first, 3), min(last, len(direction))):
        for j in range(i):
            for k in range(j):
                for m in range(k):
                    stars[0], stars[1], stars[2], stars[3] = m, k, j, i
                    count = _look_up_orders(table, direction, stars, tolerance, low, high, found,
                                            count)
    return found[0][:count].copy(), found[1][:count].copy(), found[2][:count].copy()


@compiled
def matching_neighbours(table: QuadTable, direction: np.ndarray, quads: np.ndarray,
                        tolerance: float, low: float, high: float, most: int
                        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the quads of the sky that have the code of one of quads (Q, 4), as matching_quads().

    Those with a star that has no direction, NaN, are left out.
    """
    found = np.empty((most, 4), np.int32), np.empty(most, np.int64), np.empty(most)
    stars, count = np.empty(4, np.int64), 0
    for q in range(len(quads)):
        seen = True
        for m in range(4):
            stars[m] = quads[q, m]
            seen = seen and not np.isnan(direction[stars[m], 0])
        if seen:
            count = _look_up_orders(table, direction, stars, tolerance, low, high, found, count)
    return found[0][:count].copy(), found[1][:count].copy(), found[2][:count].copy()


@compiled
def _look_up_orders(table: QuadTable, direction: np.ndarray, stars: np.ndarray, tolerance: float,
                    low: float, high: float, found: tuple[np.ndarray, np.ndarray, np.ndarray],
                    count: int) -> int:
    """Add the quads of stars (4,) to count others, in each order that noise allows."""
    longest = 0.0
    for a in range(4):
        for b in range(a):
            longest = max(longest, squared_chord(direction, stars[a], stars[b]))
    four, code = np.empty(4, np.int64), np.empty(4)
    for a in range(4):
        for b in range(a):
            square = squared_chord(direction, stars[a], stars[b])
            if square < longest * (1 - 2 * tolerance):
                continue
            four[0], four[1] = stars[a], stars[b]
            rest = 2
            for c in range(4):
                if c != a and c != b:
                    four[rest] = stars[c]
                    rest += 1
            if not quad_code(direction, four, code):
                continue
            side = 2 * np.arcsin(min(np.sqrt(square) / 2, 1.0))
            for order in range(4):
                _exchange(four, code, order & 1)
                if _in_order(code, tolerance):
                    count = _look_up(table, code, tolerance, low, high, side, four, found, count)
    return count


@inlined
def _exchange(four: np.ndarray, code: np.ndarray, ends: int) -> None:
    """Exchange A and B, or else C and D, of stars (4,) and their code (4,)."""
    if ends:
        four[0], four[1] = four[1], four[0]
        for k in range(2):
            code[2 * k], code[2 * k + 1] = 1 - code[2 * k], -code[2 * k + 1]
    else:
        four[2], four[3] = four[3], four[2]
        code[0], code[1], code[2], code[3] = code[2], code[3], code[0], code[1]


@compiled
def _look_up(table: QuadTable, code: np.ndarray, tolerance: float, low: float, high: float,
             side: float, four: np.ndarray, found: tuple[np.ndarray, np.ndarray, np.ndarray],
             count: int) -> int:
    """Add the quads within tolerance of a code (4,) of stars four (4,) to count others."""
    image, quad, ratio = found
    first_1, last_1 = _cell_y(code[1] - tolerance), _cell_y(code[1] + tolerance)
    first_3, last_3 = _cell_y(code[3] - tolerance), _cell_y(code[3] + tolerance)
    for i in range(_cell_x(code[0] - tolerance), _cell_x(code[0] + tolerance) + 1):
        for j in range(_cell_x(code[2] - tolerance), _cell_x(code[2] + tolerance) + 1):
            for k in range(first_1, last_1 + 1):
                row = ((i * _CELLS_X + j) * _CELLS_Y + k) * _CELLS_Y
                for q in range(table.start[row + first_3], table.start[row + last_3 + 1]):
                    if (count < len(quad) and low * side <= table.side[q] <= high * side
                            and abs(table.code[q, 0] - code[0]) <= tolerance
                            and abs(table.code[q, 1] - code[1]) <= tolerance
                            and abs(table.code[q, 2] - code[2]) <= tolerance
                            and abs(table.code[q, 3] - code[3]) <= tolerance):
                        for m in range(4):
                            image[count, m] = four[m]
                        quad[count], ratio[count] = q, table.side[q] / side
                        count += 1
    return count
