# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Star directions in the cells of a cube, for compiled neighbour searches."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.lens import plane_point
from startracker_ros.core.compiled import compiled, inlined


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
        most = int(np.clip(np.cbrt(64 * len(direction)), FINE, 2 * FINE))
    cells = cells_along(len(direction) / sky_share, most)
    cell = cell_numbers(direction, cells)
    start = np.zeros(cells ** 3 + 1, np.int32)
    start[1:] = np.bincount(cell, minlength=cells ** 3)
    np.cumsum(start, out=start)
    return SkyGrid(np.ascontiguousarray(direction), cells, start,
                   np.argsort(cell, kind='stable').astype(np.int32))


def cells_along(count: float, most: int) -> int:
    """Return the cells along an axis of the cube for so many stars, about one per cell."""
    # A cell of edge 2 / n covers about 4 / n**2 of the 4 pi of the sphere.
    return int(np.clip(np.sqrt(count / np.pi), 4, most))


def cell_numbers(direction: np.ndarray, cells: int) -> np.ndarray:
    """Return the cells (N,) of unit vectors (N, 3) in a cube of cells**3."""
    i, j, k = np.clip(((direction + 1) * (cells / 2)).astype(int), 0, cells - 1).T
    return (i * cells + j) * cells + k


# The brightest stars of each cell: fewer make the cells, which one star may fill, too small.
_CELL_STARS = 3


def brightest_everywhere(direction: np.ndarray, density: float) -> np.ndarray:
    """
    Return the rows (M,) of the brightest stars of each part of the sky, density a steradian.

    direction (N, 3) are unit vectors, brightest first.
    """
    side_rad = np.sqrt(_CELL_STARS / density)
    bands = int(np.ceil(np.pi / side_rad))
    declination = np.arcsin(np.clip(direction[:, 2], -1, 1))
    band = np.minimum((declination / np.pi + 0.5) * bands, bands - 1).astype(int)
    middle = ((np.arange(bands) + 0.5) / bands - 0.5) * np.pi
    across = np.ceil(2 * np.pi * np.cos(middle) / side_rad).astype(int)
    along = (np.arctan2(direction[:, 1], direction[:, 0]) / (2 * np.pi) + 0.5) * across[band]
    cell = (np.cumsum(across) - across)[band] + along.astype(int) % across[band]
    order = np.argsort(cell, kind='stable')
    # The place of each star in its own cell.
    place = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return np.sort(order[place < _CELL_STARS])


@inlined
def _cells_about(grid: SkyGrid, coordinate: float, chord: float) -> tuple[int, int]:
    """Return the first and the last cell, along one axis, within chord of a coordinate."""
    half = grid.cells / 2
    low = int((coordinate - chord + 1) * half)
    high = int((coordinate + chord + 1) * half)
    return max(low, 0), min(high, grid.cells - 1)


@inlined
def nearest(grid: SkyGrid, x: float, y: float, z: float, chord: float) -> tuple[int, float]:
    """
    Return the index of the star nearest to a unit vector and its squared chord.

    -1 and infinity when none is within chord.
    """
    best, best_square = -1, np.inf
    limit = chord * chord
    first_x, last_x = _cells_about(grid, x, chord)
    first_y, last_y = _cells_about(grid, y, chord)
    first_z, last_z = _cells_about(grid, z, chord)
    for i in range(first_x, last_x + 1):
        for j in range(first_y, last_y + 1):
            row = (i * grid.cells + j) * grid.cells
            # The cells of a row are consecutive, and so are their stars.
            for m in range(grid.start[row + first_z], grid.start[row + last_z + 1]):
                star = grid.member[m]
                dx = grid.direction[star, 0] - x
                dy = grid.direction[star, 1] - y
                dz = grid.direction[star, 2] - z
                square = dx * dx + dy * dy + dz * dz
                if square <= limit and square < best_square:
                    best, best_square = star, square
    return best, best_square


@compiled
def pairs_within(grid: SkyGrid, chord: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs i < j (P, 2) of stars within chord, and their squared chords (P,)."""
    # In the order of the cells: the stars of a cell are then side by side in memory.
    direction = grid.direction[grid.member]
    count = 0
    pairs, squares = np.empty((0, 2), np.int32), np.empty(0)
    # The second pass stores what the first one has counted.
    for stored in range(2):
        if stored:
            pairs, squares = np.empty((count, 2), np.int32), np.empty(count)
        count = 0
        for n in range(len(direction)):
            count = _add_partners(grid, direction, n, chord, pairs, squares, count)
    return pairs, squares


@inlined
def _add_partners(grid: SkyGrid, direction: np.ndarray, n: int, chord: float, pairs: np.ndarray,
                  squares: np.ndarray, count: int) -> int:
    """
    Add the pairs of star member[n] with stars of a higher index to count others.

    direction (N, 3) is in the order of grid.member. Return the number of pairs; those beyond the
    end of pairs (P, 2) and squares (P,) are counted only.
    """
    limit = chord * chord
    star = grid.member[n]
    x, y, z = direction[n, 0], direction[n, 1], direction[n, 2]
    first_x, last_x = _cells_about(grid, x, chord)
    first_y, last_y = _cells_about(grid, y, chord)
    first_z, last_z = _cells_about(grid, z, chord)
    for i in range(first_x, last_x + 1):
        for j in range(first_y, last_y + 1):
            row = (i * grid.cells + j) * grid.cells
            for m in range(grid.start[row + first_z], grid.start[row + last_z + 1]):
                dx, dy, dz = direction[m, 0] - x, direction[m, 1] - y, direction[m, 2] - z
                square = dx * dx + dy * dy + dz * dz
                if square > limit or grid.member[m] <= star:
                    continue
                if count < len(squares):
                    pairs[count, 0], pairs[count, 1] = star, grid.member[m]
                    squares[count] = square
                count += 1
    return count


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


@compiled
def count_near(grid: SkyGrid, centers: np.ndarray, chord: float) -> np.ndarray:
    """Return the number (M,) of stars within chord of each of the unit vectors (M, 3)."""
    counts = np.zeros(len(centers), np.int64)
    limit = chord * chord
    for c in range(len(centers)):
        x, y, z = centers[c, 0], centers[c, 1], centers[c, 2]
        first_x, last_x = _cells_about(grid, x, chord)
        first_y, last_y = _cells_about(grid, y, chord)
        first_z, last_z = _cells_about(grid, z, chord)
        for i in range(first_x, last_x + 1):
            for j in range(first_y, last_y + 1):
                row = (i * grid.cells + j) * grid.cells
                for m in range(grid.start[row + first_z], grid.start[row + last_z + 1]):
                    star = grid.member[m]
                    dx = grid.direction[star, 0] - x
                    dy = grid.direction[star, 1] - y
                    dz = grid.direction[star, 2] - z
                    counts[c] += dx * dx + dy * dy + dz * dz <= limit
    return counts


@compiled
def count_in_image(grid: SkyGrid, equidistant: bool, matrix: np.ndarray, chord: float,
                   low_a: float, high_a: float, low_b: float, high_b: float,
                   brightest: int) -> int:
    """
    Return how many of the brightest stars, the first ones of the catalogue, are in the field.

    matrix (3, 3) rotates sensor vectors to the axes of the grid. The image spans low_a to high_a
    and low_b to high_b in the coordinates of lens.plane_point(), within chord of its axis.
    """
    found = 0
    direction = grid.direction
    first_x, last_x = _cells_about(grid, matrix[0, 2], chord)
    first_y, last_y = _cells_about(grid, matrix[1, 2], chord)
    first_z, last_z = _cells_about(grid, matrix[2, 2], chord)
    for i in range(first_x, last_x + 1):
        for j in range(first_y, last_y + 1):
            row = (i * grid.cells + j) * grid.cells
            for m in range(grid.start[row + first_z], grid.start[row + last_z + 1]):
                star = grid.member[m]
                if star >= brightest:
                    continue
                # Scalars: a view of a row would cost more than the arithmetic.
                x, y, z = direction[star, 0], direction[star, 1], direction[star, 2]
                plane_a, plane_b = plane_point(
                    equidistant, x * matrix[0, 0] + y * matrix[1, 0] + z * matrix[2, 0],
                    x * matrix[0, 1] + y * matrix[1, 1] + z * matrix[2, 1],
                    x * matrix[0, 2] + y * matrix[1, 2] + z * matrix[2, 2])
                # NaN is in no range.
                found += low_a <= plane_a <= high_a and low_b <= plane_b <= high_b
    return found
