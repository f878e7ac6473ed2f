# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The sky file of the native core: all that it knows of the sky, for one class of cameras.

Sections of a file of stored_arrays.py, read in place by native/src/sky/sky.h, which has what they
mean. Stars and their cells are those of camera_stars(). The pattern stars, the first ones of them,
and their pairs are those of PyramidIdentifier.
"""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import SkyGrid
from startracker_ros.core.identify.cache import camera_stars, PAIRS, STARS
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.identify.pyramid import PyramidIdentifier

VERSION = 1
"""Of the sections and what is in them; SKY_VERSION of native/src/sky/sky.cpp."""


def sky_arrays(camera: Camera, epoch_year: float,
               options: IdentificationOptions = IdentificationOptions(),
               band: BandOptions = BandOptions()) -> dict[str, np.ndarray]:
    """
    Return the sections of the sky file for cameras of such pixels and field, by name.

    The places of the stars are those of the nearest whole year; directions at another time follow
    from their motion. CameraError for pixels so large that they show no stars.
    """
    stars = camera_stars(camera, round(epoch_year), band=band)
    identifier = PyramidIdentifier(camera, stars.epoch_year, options,
                                   PyramidIdentifier.catalog_for(camera, band))
    patterns = identifier.onboard.grid
    numbers = {
        'epoch_year': stars.epoch_year, 'pixel_rad': camera.pixel_rad,
        'crowd_rad': stars.crowd_rad, 'pattern_limit': identifier.magnitude_limit,
        'least_rad': identifier.least_rad, 'most_rad': identifier.most_rad}
    return {
        'sky': np.array(VERSION, np.int32),
        **{name: np.array(value, float) for name, value in numbers.items()},
        'band': np.frombuffer(band.band.encode(), np.uint8),
        **{name: getattr(stars, name) for name in STARS},
        **_cells('', stars.grid), **_cells('pattern_', patterns),
        **_pairs('pair_', identifier.pairs), **_pairs('bright_', identifier.bright_pairs)}


def star_arrays(stars: OnboardCatalog) -> dict[str, np.ndarray]:
    """Return the sections of a sky file with the stars of a catalogue alone: no patterns."""
    rows, zero = np.zeros(0, np.int32), np.array(0.0)
    no_pairs = {'star': rows, 'direction': np.zeros((0, 3)), 'separation': np.zeros(0),
                'below': np.zeros(1, np.int32), 'member': rows, 'previous': rows}
    return {
        'sky': np.array(VERSION, np.int32),
        'epoch_year': np.array(np.nan_to_num(stars.epoch_year, nan=_ANY_YEAR)),
        'pixel_rad': zero, 'crowd_rad': np.array(stars.crowd_rad, float), 'pattern_limit': zero,
        'least_rad': zero, 'most_rad': zero,
        **{name: _column(getattr(stars, name), (len(stars), *shape), kind)
           for name, (kind, *shape) in _COLUMNS.items()},
        **_cells('', stars.grid),
        **_cells('pattern_', SkyGrid(stars.direction[:1], 1, np.array([0, 1], np.int32),
                                     np.zeros(1, np.int32))),
        **{f'{prefix}{name}': array for prefix in ('pair_', 'bright_')
           for name, array in no_pairs.items()}}


# Of STARS: type and further dimensions.
_COLUMNS: dict[str, tuple[type, ...]] = {
    'hip': (np.int32,), 'direction': (np.float64, 3), 'magnitude': (np.float64,),
    'crowded': (np.bool_,), 'blended': (np.bool_,), 'variation_mag': (np.float32,),
    'motion': (np.float32, 3), 'parallax_rad': (np.float32,)}  # type: ignore[dict-item]
_ANY_YEAR = 2000.0  # of a catalogue without one


def _column(values: np.ndarray | None, shape: tuple[int, ...], kind: type) -> np.ndarray:
    """Return a column of a catalogue, zero where it has none."""
    return np.zeros(shape, kind) if values is None else np.asarray(values, kind)


def _cells(prefix: str, grid: SkyGrid) -> dict[str, np.ndarray]:
    return {f'{prefix}cells': np.array(grid.cells, np.int32), f'{prefix}start': grid.start,
            f'{prefix}member': grid.member}


def _pairs(prefix: str, pairs: PairDatabase) -> dict[str, np.ndarray]:
    return {f'{prefix}{name}': getattr(pairs, name) for name in PAIRS}
