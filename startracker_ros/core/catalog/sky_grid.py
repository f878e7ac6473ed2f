# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star directions in the cells of a cube, for searches of neighbours."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core import native


class SkyGrid(NamedTuple):
    """
    Unit vectors direction (N, 3) by cell.

    The cube around the unit sphere has cells**3 cells; the star indices of cell c are
    member[start[c]:start[c + 1]].
    """

    direction: np.ndarray
    cells: int
    start: np.ndarray
    member: np.ndarray


FINE = 128
"""Most cells along an axis, of the whole sky."""


def sky_grid(direction: np.ndarray, sky_share: float = 1.0, most: int = FINE) -> SkyGrid:
    """Return the grid of unit vectors (N, 3) of a share of the sky, about one per cell of it."""
    # Of a part of the sky most cells are empty: as many as cost no more than the stars.
    if sky_share < 1:
        most = int(np.clip(np.cbrt(64 * len(direction)), 4, 2 * FINE))
    cells = cells_along(len(direction) / sky_share, most)
    start, member = sorted_by_cell(cell_numbers(direction, cells), cells ** 3)
    return SkyGrid(np.ascontiguousarray(direction), cells, start, member)


def sorted_by_cell(cell: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the rows of each cell: those of c are order[start[c]:start[c + 1]].

    cell (N,) are below cells; start (cells + 1,) and order (N,) are int32.
    """
    start, order = np.empty(cells + 1, np.int32), np.empty(len(cell), np.int32)
    native.call('st_sort_by_cell', np.ascontiguousarray(cell, np.int32), len(cell), cells, start,
                order)
    return start, order


def cells_along(count: float, most: int) -> int:
    """Return the cells along an axis of the cube for so many stars, about one per cell."""
    # A cell of edge 2 / n covers about 4 / n**2 of the 4 pi of the sphere.
    return int(np.clip(np.sqrt(count / np.pi), 4, most))


def cell_numbers(direction: np.ndarray, cells: int) -> np.ndarray:
    """Return the cells (N,) of unit vectors (N, 3) in a cube of cells**3."""
    # A cube has fewer cells than 32 bits can count.
    i, j, k = np.minimum(((direction + 1) * (cells / 2)).astype(np.int32), cells - 1).T
    return (i * cells + j) * cells + k


# The brightest stars of each cell: fewer make the cells, which one star may fill, too small.
_CELL_STARS = 3


def sky_angles(direction: np.ndarray) -> np.ndarray:
    """Return right ascension and declination (2, N) in rad of unit vectors (N, 3)."""
    return np.stack([np.arctan2(direction[:, 1], direction[:, 0]),
                     np.arcsin(np.clip(direction[:, 2], -1, 1))])


def brightest_everywhere(angles: np.ndarray, density: float) -> np.ndarray:
    """
    Return which (N,) are the brightest stars of each part of the sky, density a steradian.

    angles (2, N) are those of sky_angles(), brightest first.
    """
    side_rad = np.sqrt(_CELL_STARS / density)
    bands = int(np.ceil(np.pi / side_rad))
    middle = ((np.arange(bands) + 0.5) / bands - 0.5) * np.pi
    first = np.zeros(bands + 1, np.int32)
    np.cumsum(np.ceil(2 * np.pi * np.cos(middle) / side_rad), out=first[1:], dtype=np.int32)
    chosen = np.zeros(angles.shape[1], bool)
    native.call('st_brightest_of_cells', *map(np.ascontiguousarray, angles), len(chosen), first,
                bands, _CELL_STARS, np.zeros(first[-1], np.uint8), chosen)
    return chosen


def pairs_within(grid: SkyGrid, chord: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs i < j (P, 2) of stars within chord, and their squared chords (P,)."""
    direction = np.ascontiguousarray(grid.direction, float)
    start, member = (np.ascontiguousarray(array, np.int32) for array in (grid.start, grid.member))
    count = np.zeros(1, np.uintp)
    # The second call stores what the first one has counted.
    for _ in range(2):
        pairs, square = np.empty((count[0], 2), np.int32), np.empty(count[0])
        native.call('st_pairs_within', direction, len(direction), start, member, grid.cells,
                    chord, pairs, square, count)
    return pairs, square


def stars_near(grid: SkyGrid, center: np.ndarray, chord: float) -> np.ndarray:
    """Return the indices (M,) of the stars within chord of a unit vector (3,), in no order."""
    first, last = np.clip(((center + [[-chord], [chord]] + 1) * (grid.cells / 2)).astype(int),
                          0, grid.cells - 1)
    i, j = np.mgrid[first[0]:last[0] + 1, first[1]:last[1] + 1].reshape(2, -1)
    row = (i * grid.cells + j) * grid.cells
    star = np.concatenate([grid.member[begin:end] for begin, end in zip(
        grid.start[row + first[2]], grid.start[row + last[2] + 1])])
    offset = grid.direction[star] - center
    return star[np.einsum('ij,ij->i', offset, offset) <= chord * chord]
