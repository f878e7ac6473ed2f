# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A catalogue for narrow fields out of a user's files, in a folder: photographs/tiles.py.

Memory is bounded, however many stars there are: they are read in pieces, written one after another
and then put into the cells of the sky; quads are made of one part of the sky after another. The
folder appears when all of it is written.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
import json
import os
from pathlib import Path
import shutil
import time
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np
from startracker_ros.core.catalog.sky_grid import cell_numbers, cells_along, SkyGrid
from startracker_ros.core.catalog.stars import CATALOG_EPOCH_YEAR, StarCatalog
from startracker_ros.core.maths.rotation import radec_from_unit
from startracker_ros.io.output import output_folder
from startracker_ros.io.progress import progress
from startracker_ros.io.star_tables import read_stars, Stars
from startracker_ros.io.table import Result
from startracker_ros.photographs.ladder import REFERENCE_YEAR
from startracker_ros.photographs.searched_fields import TILED_HIGHEST_DEG
from startracker_ros.photographs.sky_quads import (
    CODE_CELLS, code_cells, level_sides_deg, quads_of)
from startracker_ros.photographs.tiled import (
    Fields, QUAD_DENSITY, QUAD_INNER, side_range_deg)
from startracker_ros.photographs.tiles import (
    CatalogueError, COLUMNS, DESCRIPTION, double_precision, FORMAT, QUADS, VERSION)


_ROW = np.dtype([*COLUMNS.items(), ('direction', np.float32, 3)])
_QUAD = np.dtype([('code', np.float32, 4), ('star', np.int32, 4), ('side', np.float32)])
_PIECE = 1_000_000  # stars that are put into their cells at once
_MOST_CELLS = 256  # along each axis of the cube: one is then 0.45 deg wide
_SLAB_STARS = 1_000_000  # whose quads are made at once, with those about them
# The brightest stars of a level are those of cells so wide, in sides of its quads, at most.
_LEVEL_CELL = np.sqrt(3 / QUAD_DENSITY)
# Equal parts of the sky, by which it is said how much of it a catalogue covers.
_PARTS_Z, _PARTS_RA = 180, 360
_MAGNITUDES = -30.0, 50.0


class Read(NamedTuple):
    """What was read: stars, rows left out, parts of the sky, largest magnitude, epochs."""

    stars: int
    left_out: int
    sky_share: float
    faintest: float
    epochs: tuple[float, float]


def build_catalogue(files: Sequence[Path], folder: Path, *, columns: Mapping[str, str] = {},
                    epoch_year: float | None = None, faintest: float = np.inf,
                    least_deg: float, blind: bool = True) -> Result:
    """
    Write the stars of files into a folder, which is replaced if it is a catalogue.

    columns are names by role (io/star_tables.py), faintest the limit in magnitudes, least_deg the
    narrowest field of view that is searched. blind is whether the whole sky can be searched:
    quads of all of it are written. CatalogueError, OutputError, MissingLibraryError.
    """
    start_s = time.perf_counter()
    with _new_folder(folder) as part:
        spooled = part / 'stars.part'
        read = _spool(files, spooled, columns, epoch_year, faintest)
        cells = cells_along(read.stars, _MOST_CELLS)
        sky = _place(spooled, part, cells)
        spooled.unlink()
        quads = _write_quads(part, sky, Fields(least_deg, TILED_HIGHEST_DEG)) if blind else 0
        row = {'catalogue': str(folder), 'stars': read.stars, 'left_out': read.left_out,
               'faintest': read.faintest, 'sky_percent': 100 * read.sky_share, 'quads': quads,
               'mb': sum(file.stat().st_size for file in part.iterdir()) / 1e6}
        _describe(part, {
            'format': FORMAT, 'version': VERSION, 'source': [file.name for file in files],
            'epoch_year': read.epochs, 'stars': read.stars, 'cells': cells,
            'faintest': read.faintest, 'sky_share': read.sky_share, 'least_deg': least_deg,
            'quads': quads})
    return Result('catalogue', [{**row, 'seconds': time.perf_counter() - start_s}], {
        'source': ', '.join(file.name for file in files),
        'epoch': ' to '.join(f'{year:g}' for year in dict.fromkeys(read.epochs))})


@contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces a catalogue, or nothing, when it is complete."""
    if folder.exists() and not (folder.is_dir() and (
            (folder / DESCRIPTION).is_file() or not any(folder.iterdir()))):
        raise CatalogueError(f'{folder}: it is there and no catalogue: give another --output')
    output_folder(folder.absolute().parent)
    part = folder.absolute().with_name(f'{folder.name}-{uuid4().hex}.part')
    output_folder(part)
    try:
        yield part
        for file in part.iterdir():
            with file.open('rb') as written:
                os.fsync(written.fileno())
        if folder.exists():
            old = part.with_suffix('.old')
            folder.rename(old)
            part.rename(folder)
            shutil.rmtree(old)
        else:
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _describe(part: Path, description: Mapping[str, Any]) -> None:
    sizes = {file.name: file.stat().st_size for file in sorted(part.iterdir())}
    (part / DESCRIPTION).write_text(json.dumps({**description, 'bytes': sizes}, indent=1))


def _stored(path: Path, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return a new array of zeros, mapped from a file; OSError where the disk has no room."""
    array = np.lib.format.open_memmap(path, 'w+', dtype, shape)
    with path.open('r+b') as file:
        # Otherwise a full disk ends the process when the array is written to.
        try:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
        except OSError as error:
            needed, free = path.stat().st_size / 1e6, shutil.disk_usage(path.parent).free / 1e6
            raise CatalogueError(
                f'{path.parent.parent}: {error.strerror}: the next file has {needed:.0f} MB, '
                f'{free:.0f} MB are free: another --output, a brighter --faintest, or '
                '--no-blind') from error
    return array


def _spool(files: Sequence[Path], spooled: Path, columns: Mapping[str, str],
           epoch_year: float | None, faintest: float) -> Read:
    """Write the stars of files as they come."""
    stars = left_out = 0
    parts = np.zeros(_PARTS_Z * _PARTS_RA, bool)
    most, epochs = -np.inf, [np.inf, -np.inf]
    with spooled.open('wb') as file:
        pieces = ((one, piece) for one in files for piece in read_stars(one, columns))
        for path, piece in progress(pieces, 'read'):
            kept, year = _checked(path, piece, epoch_year, faintest)
            rows = _rows(kept, year)
            file.write(rows.tobytes())
            stars += len(rows)
            left_out += len(piece['ra']) - len(rows)
            if len(rows):
                parts[_part(rows['direction'])] = True
                most = max(most, float(rows['magnitude'].max()))
                epochs = [min(epochs[0], float(year.min())), max(epochs[1], float(year.max()))]
    if not stars:
        raise CatalogueError(f'{", ".join(map(str, files))}: no stars with position and magnitude'
                             + (f' up to {faintest:g} mag' if np.isfinite(faintest) else ''))
    return Read(stars, left_out, float(parts.mean()), most, (epochs[0], epochs[1]))


def _checked(path: Path, piece: Stars, epoch_year: float | None, faintest: float
             ) -> tuple[Stars, np.ndarray]:
    """Return the stars with position and magnitude, and their epochs; CatalogueError."""
    known = np.isfinite(piece['ra']) & np.isfinite(piece['dec']) & np.isfinite(piece['magnitude'])
    for role, low, high in (('ra', -360.0, 360.0), ('dec', -90.0, 90.0),
                            ('magnitude', *_MAGNITUDES)):
        value = piece[role][known]
        wrong = np.flatnonzero((value < low) | (value > high))
        if len(wrong):
            raise CatalogueError(f'{path}: {role} is {value[wrong[0]]:g}, not within {low:g} to '
                                 f'{high:g}: name the right column with --column {role}=NAME')
    known &= piece['magnitude'] <= faintest
    kept = {role: column[known] for role, column in piece.items()}
    if epoch_year is not None:
        return kept, np.full(len(kept['ra']), epoch_year)
    if 'epoch' not in kept:
        raise CatalogueError(f'{path}: no column of the epoch: give --epoch, 2016 for Gaia DR3')
    year = kept['epoch']
    if not ((year > 1800) & (year < 2200)).all():
        raise CatalogueError(f'{path}: epochs that are not years from 1800 to 2200: give --epoch')
    return kept, year


def _rows(stars: Stars, year: np.ndarray) -> np.ndarray:
    """Return stars of epochs (N,) as they are stored, at the epoch of StarCatalog."""
    count = len(year)
    nothing = np.zeros(count, np.float32)
    # Without a motion a star is taken to stand still.
    motion = {name: np.nan_to_num(stars.get(role, nothing)).astype(np.float32)
              for name, role in (('pm_ra_mas_yr', 'pmra'), ('pm_dec_mas_yr', 'pmdec'))}
    then = StarCatalog(hip=np.zeros(count, np.int32), ra_rad=np.radians(stars['ra']),
                       dec_rad=np.radians(stars['dec']), parallax_mas=nothing, bp_rp=nothing,
                       magnitude=stars['magnitude'].astype(np.float32), variation_mag=nothing,
                       **motion)
    rows = np.empty(count, _ROW)
    rows['magnitude'] = then.magnitude
    for name, values in motion.items():
        rows[name] = values
    for one in np.unique(year):
        mine = year == one
        # As if its epoch were that of the catalogue: so many years later, or earlier.
        rows['ra_rad'][mine], rows['dec_rad'][mine] = radec_from_unit(
            then.rows(mine).directions(2 * CATALOG_EPOCH_YEAR - one))
        rows['direction'][mine] = then.rows(mine).directions(
            CATALOG_EPOCH_YEAR + REFERENCE_YEAR - one)
    return rows


def _part(direction: np.ndarray) -> np.ndarray:
    """Return the part of the sky (N,) of unit vectors (N, 3), all equal by Archimedes."""
    x, y, z = direction.T
    band = np.clip((z + 1) / 2 * _PARTS_Z, 0, _PARTS_Z - 1).astype(int)
    along = np.clip((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _PARTS_RA, 0, _PARTS_RA - 1)
    return band * _PARTS_RA + along.astype(int)


def _place(spooled: Path, part: Path, cells: int) -> SkyGrid:
    """Write the arrays of all stars in the order of their cells; return their grid."""
    rows = _spooled(spooled, _ROW)
    start = _stored(part / 'start.npy', np.int32, (cells ** 3 + 1,))
    for piece in _pieces(rows, 'count'):
        cell, number = np.unique(cell_numbers(piece['direction'], cells), return_counts=True)
        start[1:][cell] += number.astype(np.int32)
    np.cumsum(start[1:], out=start[1:])
    arrays = {name: _stored(part / f'{name}.npy', dtype, (len(rows),))
              for name, dtype in COLUMNS.items()}
    direction = _stored(part / 'direction.npy', np.float32, (len(rows), 3))
    # Rows are in this order already: the grid takes them as they are.
    member = _stored(part / 'member.npy', np.int32, (len(rows),))
    member[:] = np.arange(len(rows))
    place = _Places(start)
    for piece in _pieces(rows, 'place'):
        order, at = place.of(cell_numbers(piece['direction'], cells))
        for name, array in arrays.items():
            array[at] = piece[name][order]
        direction[at] = piece['direction'][order]
    return SkyGrid(direction, cells, start, member)


def _pieces(rows: np.ndarray, title: str) -> Iterable[np.ndarray]:
    """Return rows (N,) in pieces."""
    first = range(0, len(rows), _PIECE)
    return progress((rows[one:one + _PIECE] for one in first), title, len(first))


class _Places:
    """Where what belongs to a cell is put, piece by piece, cell c being from start[c] on."""

    def __init__(self, start: np.ndarray) -> None:
        self._next = np.array(start[:-1])

    def of(self, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return an order (N,) of a piece of cells (N,), and where each is put in that order."""
        order = np.argsort(cell, kind='stable')
        found, first, count = np.unique(cell[order], return_index=True, return_counts=True)
        at = (np.repeat(self._next[found] - first, count) + np.arange(len(order)))
        self._next[found] += count.astype(self._next.dtype)
        return order, at


def _write_quads(part: Path, sky: SkyGrid, fields: Fields) -> int:
    """Write the quads of the whole sky, at first as they are made; return how many."""
    magnitude = np.load(part / 'magnitude.npy', mmap_mode='r')
    code_file, star_file, side_file, start_file = (part / f'{name}.npy' for name in QUADS)
    quad_start = _stored(start_file, np.int32, (CODE_CELLS + 1,))
    spooled = part / 'quads.part'
    parts = [*product(level_sides_deg(*side_range_deg(fields)), _slabs(sky))]
    with spooled.open('wb') as file:
        for side_deg, (first, last) in progress(parts, 'make quads', len(parts)):
            quads = _quads_of_slab(sky, magnitude, first, last, side_deg)
            quad_start[1:] += np.bincount(
                _code_cells(quads), minlength=CODE_CELLS).astype(np.int32)
            file.write(quads.tobytes())
    np.cumsum(quad_start[1:], out=quad_start[1:])
    count = int(quad_start[-1])
    codes = _stored(code_file, np.float32, (count, 4))
    stars = _stored(star_file, np.int32, (count, 4))
    sides = _stored(side_file, np.float32, (count,))
    place = _Places(quad_start)
    for piece in _pieces(_spooled(spooled, _QUAD), 'place quads'):
        order, at = place.of(_code_cells(piece))
        piece = piece[order]
        codes[at], stars[at], sides[at] = piece['code'], piece['star'], piece['side']
    spooled.unlink()
    return count


def _code_cells(quads: np.ndarray) -> np.ndarray:
    return code_cells(np.ascontiguousarray(quads['code']))


def _spooled(path: Path, dtype: np.dtype) -> np.ndarray:
    """Return the records of a file, which may have none."""
    return np.memmap(path, dtype, 'r') if path.stat().st_size else np.empty(0, dtype)


def _slabs(sky: SkyGrid) -> list[tuple[int, int]]:
    """Return slices of the cube, first and one after the last, of _SLAB_STARS or a slice."""
    until = sky.start[sky.cells ** 2::sky.cells ** 2].astype(np.int64)
    slabs, first = list[tuple[int, int]](), 0
    while first < sky.cells:
        before = until[first - 1] if first else 0
        last = max(int(np.searchsorted(until, before + _SLAB_STARS, side='right')), first + 1)
        slabs.append((first, last))
        first = last
    return slabs


def _quads_of_slab(sky: SkyGrid, magnitude: np.ndarray, first: int, last: int, side_deg: float
                   ) -> np.ndarray:
    """Return the quads (Q,) of a level whose star A is in slices of the sky, first to last."""
    until = sky.start[::sky.cells ** 2]
    # A quad reaches so far, and the cells of the stars that it is made of.
    reach = np.radians(side_deg) * (np.sqrt(2) + _LEVEL_CELL)
    margin = int(np.ceil(reach * sky.cells / 2)) + 1
    low, high = max(first - margin, 0), min(last + margin, sky.cells)
    offset = int(until[low])
    near = slice(offset, int(until[high]))
    order = np.argsort(magnitude[near], kind='stable')
    # Slices of a sphere are as large as they are thick.
    code, star, side = quads_of(
        double_precision(sky.direction[near][order]), side_deg, 1.1 * side_deg, QUAD_DENSITY,
        even=True, inner=QUAD_INNER, sky_share=(high - low) / sky.cells)
    row = (order + offset).astype(np.int32)[star]
    mine = (row[:, 0] >= until[first]) & (row[:, 0] < until[last])
    quads = np.empty(np.count_nonzero(mine), _QUAD)
    quads['code'], quads['star'], quads['side'] = code[mine], row[mine], side[mine]
    return quads
