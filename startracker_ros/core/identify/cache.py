# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Catalogues and pairs of cameras in the user's cache, keyed by what they are built from."""

from dataclasses import fields
from typing import Any

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import (
    CROWD_MAGNITUDES, onboard_catalog, OnboardCatalog)
from startracker_ros.core.catalog.sky_grid import FINE, sky_grid, SkyGrid
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.identify.pairs import build_pairs, MOST_PAIRS, PairDatabase
from startracker_ros.core.stored_arrays import digest, stored_arrays

STARS = ('hip', 'direction', 'magnitude', 'crowded', 'blended', 'variation_mag', 'motion',
         'parallax_rad')
"""Arrays of OnboardCatalog that are stored."""

# Along an axis, of the cells in which all stars of a field are sought: 4 deg wide.
_CONE_CELLS = 32

PAIRS = tuple(field.name for field in fields(PairDatabase) if field.name != 'stored')
"""Arrays of PairDatabase that are stored."""


def cached_onboard(catalog: StarCatalog, camera: Camera, epoch_year: float,
                   magnitude_limit: float, least_density: float = 0.0, most_cells: int = FINE
                   ) -> OnboardCatalog:
    """Return onboard_catalog() and its grid from the cache, or build and store them."""
    def build() -> dict[str, np.ndarray]:
        onboard = onboard_catalog(catalog, camera, epoch_year, magnitude_limit, least_density)
        grid = sky_grid(onboard.direction, most=most_cells)
        return {**{name: getattr(onboard, name) for name in STARS},
                'cells': np.array(grid.cells), 'crowd_rad': np.array(onboard.crowd_rad),
                'start': grid.start, 'member': grid.member}
    key = digest(catalog.digest, camera.pixel_rad, epoch_year, magnitude_limit, least_density,
                 most_cells)
    stored = stored_arrays('catalogue', key, build)
    arrays = stored.arrays
    stars: dict[str, Any] = {name: arrays[name] for name in STARS}
    onboard = OnboardCatalog(**stars, crowd_rad=float(arrays['crowd_rad']), stored=stored,
                             epoch_year=epoch_year)
    # What is otherwise computed when first used.
    vars(onboard).update(digest=key, grid=SkyGrid(
        onboard.direction, int(arrays['cells']), arrays['start'], arrays['member']))
    return onboard


def cached_brightest(catalog: StarCatalog, camera: Camera, epoch_year: float,
                     magnitude_limit: float, least_density: float = 0.0) -> OnboardCatalog:
    """Return cached_onboard() of the stars of a large catalogue that have a part in it."""
    bright = catalog.brighter_than(magnitude_limit + CROWD_MAGNITUDES)
    # That of its columns takes long for each of many limits.
    vars(bright).update(digest=digest(catalog.digest, len(bright)))
    return cached_onboard(bright, camera, epoch_year, magnitude_limit, least_density)


def cached_pairs(onboard: OnboardCatalog, min_separation_rad: float,
                 max_separation_rad: float, most_pairs: float = MOST_PAIRS,
                 brightest: int | None = None) -> PairDatabase:
    """
    Return build_pairs() from the cache, or build and store them.

    With brightest, only those among this number of catalogue entries.
    """
    def build() -> dict[str, np.ndarray]:
        if brightest is None:
            pairs = build_pairs(onboard, min_separation_rad, max_separation_rad, most_pairs)
        else:
            pairs = cached_pairs(onboard, min_separation_rad, max_separation_rad, most_pairs)
            pairs = pairs.among(int(np.searchsorted(pairs.star, brightest)))
        return {name: getattr(pairs, name) for name in PAIRS}
    stored = stored_arrays('pairs', digest(
        onboard.digest, min_separation_rad, max_separation_rad, most_pairs, brightest), build)
    return PairDatabase(**stored.arrays, stored=stored)


def camera_stars(camera: Camera, epoch_year: float, magnitude_limit: float = np.inf,
                 band: BandOptions = BandOptions()) -> OnboardCatalog:
    """
    Return the stars of the package as a camera resolves them at a Julian year.

    The catalogue of the nearest whole year is mapped from the cache, the same for all magnitude
    limits; directions are moved from there. CameraError as of onboard_catalog().
    """
    catalog = camera_catalog(camera, band=band)
    return cached_onboard(
        catalog, camera, round(epoch_year), np.inf, most_cells=_CONE_CELLS
    ).brighter_than(magnitude_limit).at(epoch_year)
