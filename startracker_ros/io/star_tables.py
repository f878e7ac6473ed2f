# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of stars in pieces, so that no table need fit into memory: CSV, FITS and Parquet."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
import gzip
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, TextIO
import zlib

import numpy as np
from startracker_ros.core.extras import extra

Stars = dict[str, np.ndarray]
"""Columns (N,) float64 by role, NaN where a value is missing."""


class CatalogueError(ValueError):
    """A catalogue that cannot be read or made: the text says what, where and what to do."""


class Role(NamedTuple):
    """What a column is, and the names that it has in known catalogues, in lower case."""

    meaning: str
    names: tuple[str, ...]


ROLES = {
    'ra': Role('right ascension in deg', (
        'ra', 'ra_deg', 'ra_icrs', 'raj2000', 'ra_degrees', 'ra_degrees_j2000')),
    'dec': Role('declination in deg', (
        'dec', 'dec_deg', 'de_icrs', 'dej2000', 'dec_degrees', 'dec_degrees_j2000')),
    'magnitude': Role('magnitude', (
        'magnitude', 'phot_g_mean_mag', 'gmag', 'mag', 'vmag')),
    'pmra': Role('proper motion in right ascension in mas/yr, with the factor cos(dec)', (
        'pmra', 'pm_ra', 'pm_ra_mas_yr', 'ra_mas_per_year')),
    'pmdec': Role('proper motion in declination in mas/yr', (
        'pmdec', 'pmde', 'pm_dec', 'pm_dec_mas_yr', 'dec_mas_per_year')),
    'epoch': Role('Julian year of the position', ('ref_epoch', 'epoch', 'epoch_year'))}
"""Columns that are read; the first three are needed."""

NEEDED = 'ra', 'dec', 'magnitude'

_PIECE, _LISTED = 500_000, 12
_GZIP, _PARQUET, _FITS = b'\x1f\x8b', b'PAR1', b'SIMPLE  ='
_MISSING = ('', 'null', 'none', 'nan', '--', 'n/a')


def read_stars(path: Path, given: Mapping[str, str]) -> Iterator[Stars]:
    """
    Yield the stars of a file in pieces; given are names of columns by role, for unknown ones.

    CatalogueError for a file that is no such table or lacks a column; MissingLibraryError.
    """
    try:
        with path.open('rb') as file:
            begin = file.read(len(_FITS))
        if begin.startswith(_GZIP):
            with gzip.open(path) as packed:
                begin = packed.read(len(_FITS))
        if begin.startswith(_PARQUET):
            yield from _parquet(path, given)
        elif begin.startswith(_FITS):
            yield from _fits(path, given)
        else:
            yield from _text(path, given)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, 'strerror', None) or str(error)
        raise CatalogueError(f'{path}: {reason}') from error


def _columns(path: Path, names: Sequence[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return the name of the column of each role; CatalogueError names what is missing."""
    lower = {name.lower(): name for name in reversed(names)}
    found = {}
    for role, (meaning, known) in ROLES.items():
        named = given.get(role)
        if named is not None and named not in names:
            raise CatalogueError(f'{path}: no column {named}; there are {_listed(names)}')
        name = named or next((lower[one] for one in known if one in lower), None)
        if name is not None:
            found[role] = name
        elif role in NEEDED:
            raise CatalogueError(f'{path}: no column of the {meaning}; name it with --column '
                                 f'{role}=NAME, there are {_listed(names)}')
    return found


def _listed(names: Sequence[str]) -> str:
    more = f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''
    return ', '.join(names[:_LISTED]) + more


def _text(path: Path, given: Mapping[str, str]) -> Iterator[Stars]:
    """Yield the stars of a CSV file, the first line that is not a comment being its names."""
    try:
        with (gzip.open(path, 'rt', newline='') if path.suffix == '.gz'
              else path.open(newline='')) as file:
            yield from _rows(path, file, given)
    except (UnicodeDecodeError, csv.Error) as error:
        raise CatalogueError(f'{path}: neither CSV nor a FITS table nor Parquet') from error


def _rows(path: Path, file: TextIO, given: Mapping[str, str]) -> Iterator[Stars]:
    lines: Iterable[str] = (line for line in file if not line.startswith('#'))
    header = next(iter(lines), '')
    delimiter = max(',;\t|', key=header.count)
    names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter), [])]
    column = {role: names.index(name) for role, name in _columns(path, names, given).items()}
    reader, number = csv.reader(lines, delimiter=delimiter), 1
    while rows := list(islice(reader, _PIECE)):
        rows, first = [row for row in rows if row], number
        number += len(rows)
        for k, row in enumerate(rows):
            if len(row) != len(names):
                raise CatalogueError(f'{path}: row {first + k} has {len(row)} values, the header '
                                     f'{len(names)} names: it is not whole, or no CSV')
        yield {role: _numbers(path, [row[index] for row in rows], names[index], first)
               for role, index in column.items()}


def _numbers(path: Path, texts: Sequence[str], name: str, first: int) -> np.ndarray:
    try:
        return np.array(texts, float)
    except ValueError:
        values = np.full(len(texts), np.nan)
    for k, text in enumerate(texts):
        if text.strip().lower() not in _MISSING:
            try:
                values[k] = float(text)
            except ValueError as error:
                raise CatalogueError(f'{path}: row {first + k}: {name} is {text!r}, no number'
                                     ) from error
    return values


def _fits(path: Path, given: Mapping[str, str]) -> Iterator[Stars]:
    """Yield the stars of the first table of a FITS file."""
    with extra('fits', 'astropy', 'A FITS table'):
        from astropy.io import fits
    try:
        with fits.open(path, memmap=True) as units:
            unit = next((one for one in units if isinstance(one, fits.BinTableHDU)), None)
            if unit is None:
                raise CatalogueError(f'{path}: a FITS file without a table: give that of a '
                                     'catalogue')
            column = _columns(path, unit.columns.names, given)
            for first in range(0, len(unit.data), _PIECE):
                piece = unit.data[first:first + _PIECE]
                yield {role: _filled(piece[name]) for role, name in column.items()}
    except (OSError, CatalogueError):
        raise
    # astropy raises errors of many types for damaged files.
    except Exception as error:  # noqa: B902
        raise CatalogueError(f'{path}: astropy cannot read this FITS file: {error}') from error


def _filled(column: Any) -> np.ndarray:
    values: np.ndarray = np.ma.filled(np.ma.asarray(column, float), np.nan)
    return np.ascontiguousarray(values, float)


def _parquet(path: Path, given: Mapping[str, str]) -> Iterator[Stars]:
    """Yield the stars of a Parquet file."""
    with extra('parquet', 'pyarrow', 'A Parquet file'):
        import pyarrow
        from pyarrow import parquet
    try:
        with parquet.ParquetFile(path) as file:
            column = _columns(path, file.schema_arrow.names, given)
            for piece in file.iter_batches(_PIECE, columns=[*column.values()]):
                yield {role: piece.column(name).cast(pyarrow.float64()).to_numpy(
                    zero_copy_only=False) for role, name in column.items()}
    except pyarrow.ArrowException as error:
        raise CatalogueError(f'{path}: pyarrow cannot read it: {error}') from error
