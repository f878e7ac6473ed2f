# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sky file of the native core with stars alone, as sky_file.py has the whole one."""

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import SkyGrid

VERSION = 1
"""Of the sections and what is in them; SKY_VERSION of native/src/sky/sky.cpp."""

# Of the arrays of an OnboardCatalog: type and further dimensions.
_COLUMNS: dict[str, tuple[type, tuple[int, ...]]] = {
    'hip': (np.int32, ()), 'direction': (np.float64, (3,)), 'magnitude': (np.float64, ()),
    'crowded': (np.bool_, ()), 'blended': (np.bool_, ()), 'variation_mag': (np.float32, ()),
    'motion': (np.float32, (3,)), 'parallax_rad': (np.float32, ())}
_ANY_YEAR = 2000.0  # of a catalogue without one


def star_arrays(stars: OnboardCatalog) -> dict[str, np.ndarray]:
    """Return the sections of a sky file with the stars of a catalogue alone: no patterns."""
    rows, zero = np.zeros(0, np.int32), np.array(0.0)
    no_pairs: dict[str, np.ndarray] = {
        'star': rows, 'direction': np.zeros((0, 3)), 'separation': np.zeros(0),
        'below': np.zeros(1, np.int32), 'member': rows, 'previous': rows}
    return {
        'sky': np.array(VERSION, np.int32),
        'epoch_year': np.array(np.nan_to_num(float(stars.epoch_year), nan=_ANY_YEAR)),
        'pixel_rad': zero, 'crowd_rad': np.array(stars.crowd_rad, float), 'pattern_limit': zero,
        'least_rad': zero, 'most_rad': zero,
        **{name: _column(getattr(stars, name), (len(stars), *shape), kind)
           for name, (kind, shape) in _COLUMNS.items()},
        **cell_arrays('', stars.grid),
        **cell_arrays('pattern_', SkyGrid(
            stars.direction[:1], 1, np.array([0, 1], np.int32), np.zeros(1, np.int32))),
        **{f'{prefix}{name}': array for prefix in ('pair_', 'bright_')
           for name, array in no_pairs.items()}}


def cell_arrays(prefix: str, grid: SkyGrid) -> dict[str, np.ndarray]:
    """Return the sections of the cells of a grid."""
    return {f'{prefix}cells': np.array(grid.cells, np.int32), f'{prefix}start': grid.start,
            f'{prefix}member': grid.member}


def _column(values: np.ndarray | None, shape: tuple[int, ...], kind: type) -> np.ndarray:
    """Return a column of a catalogue, zero where it has none."""
    return np.zeros(shape, kind) if values is None else np.asarray(values, kind)
