# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A star catalogue in a folder, as deep as its source: mapped, and read only where it is needed.

The stars are in the order of the cells of a cube (sky_grid.py), so that those of a part of the sky
are in a few places of each file. Each array is a file of NumPy; DESCRIPTION, written last, says
what they are of.
"""

from functools import cached_property
import json
from pathlib import Path

import numpy as np
from startracker_ros.core.catalog.deep import TILED_OFFSET
from startracker_ros.core.catalog.sky_grid import SkyGrid, stars_near
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.io.star_tables import CatalogueError

DESCRIPTION = 'catalogue.json'
FORMAT = 'startracker catalogue'
VERSION = 1
"""To be raised whenever other arrays, or arrays of another meaning, are in the folder."""

COLUMNS = {'ra_rad': np.dtype(float), 'dec_rad': np.dtype(float),
           'pm_ra_mas_yr': np.dtype(np.float32), 'pm_dec_mas_yr': np.dtype(np.float32),
           'magnitude': np.dtype(np.float32)}
"""Those of StarCatalog."""

GRID = 'direction', 'start', 'member'
"""Arrays of the SkyGrid; the directions are of the reference year, float32."""

QUADS = 'quad_code', 'quad_star', 'quad_side', 'quad_start'
"""Arrays of the QuadTable (sky_quads.py) of a search of the whole sky."""


class TiledCatalogue:
    """The catalogue of a folder that `startracker catalogue` has written."""

    def __init__(self, folder: str | Path) -> None:
        """Read the description; the arrays are mapped when they are used. CatalogueError."""
        self.folder = Path(folder)
        self.description = _description(self.folder)

    def array(self, name: str) -> np.ndarray:
        """Return an array, mapped; CatalogueError where its file cannot be read."""
        try:
            return np.asarray(np.load(self.folder / f'{name}.npy', mmap_mode='r'))
        except (OSError, ValueError) as error:
            raise CatalogueError(f'{self.folder}: {name}.npy cannot be read ({error}): make the '
                                 'catalogue again with startracker catalogue') from error

    @cached_property
    def grid(self) -> SkyGrid:
        """Return the grid of all stars, by row."""
        direction, start, member = map(self.array, GRID)
        return SkyGrid(direction, self.description['cells'], start, member)

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        return {name: self.array(name) for name in COLUMNS}

    def rows_near(self, center: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return the rows (M,) of the stars within a radius of center (3,), brightest first."""
        row = stars_near(self.grid, center, 2 * np.sin(min(radius_rad, np.pi) / 2))
        return row[np.lexsort((row, self._columns['magnitude'][row]))]

    @staticmethod
    def numbers(row: np.ndarray) -> np.ndarray:
        """Return the numbers of the stars of rows, of the same shape."""
        return (row + TILED_OFFSET).astype(np.int32)

    def stars(self, row: np.ndarray) -> StarCatalog:
        """Return the stars of rows (M,) in this order."""
        nothing = np.zeros(len(row), np.float32)
        return StarCatalog(
            hip=self.numbers(row), parallax_mas=nothing, bp_rp=nothing,
            variation_mag=nothing, **{name: column[row] for name, column in self._columns.items()})


def double_precision(direction: np.ndarray) -> np.ndarray:
    """
    Return unit vectors (N, 3) of the files with their length as exact as that of others.

    Codes of small quads are of differences along them.
    """
    vector = direction.astype(float)
    return vector / np.sqrt(np.einsum('ij,ij->i', vector, vector))[:, None]


def _description(folder: Path) -> dict:
    """Return what a folder says of itself, if its files are whole; CatalogueError."""
    remedy = 'make it again with startracker catalogue'
    try:
        text = (folder / DESCRIPTION).read_text()
    except OSError as error:
        what = ('no such folder' if not folder.exists() else 'not a folder, give the one that '
                'startracker catalogue has written' if not folder.is_dir() else
                f'no catalogue, {DESCRIPTION} is missing: {remedy}')
        raise CatalogueError(f'{folder}: {what}') from error
    try:
        description = json.loads(text)
        version = description['version'] if description['format'] == FORMAT else None
        sizes = description['bytes']
    except (ValueError, KeyError, TypeError) as error:
        raise CatalogueError(f'{folder}: {DESCRIPTION} is damaged: {remedy}') from error
    if version != VERSION:
        raise CatalogueError(f'{folder}: catalogue of version {version}, this program reads '
                             f'{VERSION}: {remedy}')
    for name, size in sizes.items():
        file = folder / name
        found = file.stat().st_size if file.is_file() else 0
        if found != size:
            raise CatalogueError(f'{folder}: {name} has {found} of {size} bytes, it is not whole: '
                                 f'{remedy}')
    return description
