# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
One catalogue for fields of view of any width.

All stars are in one list, brightest first. A level is those that a field of a width needs: up to a
magnitude, and the brightest ones of each part of the sky. Of a level the file has the numbers of
its stars by the cells of the sky, so that a search reads the list itself, whatever the field.

A search takes close doubles for two stars. The stars about an image that is identified are those
that its pixels resolve, as of any camera.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import (
    CROWD_MAGNITUDES, onboard_catalog, OnboardCatalog)
from startracker_ros.core.catalog.sky_grid import (
    brightest_everywhere, cell_numbers, cells_along, FINE, sky_angles, SkyGrid, sorted_by_cell)
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.identify.cache import cached_brightest
from startracker_ros.core.identify.identification import limit_for
from startracker_ros.core.stored_arrays import digest, stored_arrays, StoredArrays


@dataclass(frozen=True)
class LevelCatalog(OnboardCatalog):
    """All stars, of which a level has those with its bit in levels (N,) uint32."""

    levels: np.ndarray | None = None
    level: int = 0

    def index_of(self, hip: np.ndarray) -> np.ndarray:
        """Return the star index (M,) of each number (M,), -1 if the level does not have it."""
        index = super().index_of(hip)
        if self.levels is None:
            return index
        return np.where((index >= 0) & (self.levels[index] >> self.level & 1 > 0), index, -1)


class _Width(NamedTuple):
    """Of a level: a camera, its magnitude limit and the density of its stars a steradian."""

    camera: Camera
    limit: float
    density: float


class SkyLevels:
    """The levels of cameras, the widest first, with so many stars in a field on average."""

    def __init__(self, load: Callable[[], StarCatalog], epoch_year: float,
                 cameras: Sequence[Camera], stars_per_field: float) -> None:
        """Load the stars, and load or build the levels, when they are first used."""
        self._load, self._epoch_year = load, epoch_year
        self._cameras, self._stars_per_field = cameras, stars_per_field
        self._levels: dict[int, LevelCatalog] = {}

    def level(self, number: int) -> LevelCatalog:
        """Return the stars of a level."""
        if number not in self._levels:
            arrays, every = self.stored.arrays, self._every
            self._levels[number] = replace(every, level=number)
            vars(self._levels[number]).update(_index_of_hip=every._index_of_hip, grid=SkyGrid(
                every.direction, int(arrays['cells'][number]), arrays[f'start_{number}'],
                arrays[f'member_{number}']))
        return self._levels[number]

    def resolved(self, number: int) -> OnboardCatalog:
        """Return the stars of a level as its camera sees them, from the cache: for many images."""
        camera, limit, density = self._widths[number]
        return cached_brightest(self._catalog, camera, self._epoch_year, limit, density)

    def about(self, number: int, center: np.ndarray, radius_rad: float) -> OnboardCatalog:
        """Return the stars of a level within a radius of center (3,), as its camera sees them."""
        camera, limit, density = self._widths[number]
        bright = self._catalog.brighter_than(limit + CROWD_MAGNITUDES)
        near = np.flatnonzero(
            self._every.direction[:len(bright)] @ center >= np.cos(min(radius_rad, np.pi)))
        share = (1 - np.cos(min(radius_rad, np.pi))) / 2
        return onboard_catalog(bright.rows(near), camera, self._epoch_year, limit, density,
                               float(share))

    @cached_property
    def _catalog(self) -> StarCatalog:
        return self._load()

    @cached_property
    def _widths(self) -> list[_Width]:
        return [_Width(camera, limit_for(camera, self._catalog, self._stars_per_field),
                       self._stars_per_field / (camera.fov_x_rad * camera.fov_y_rad))
                for camera in self._cameras]

    @cached_property
    def stored(self) -> StoredArrays:
        """Return the arrays of all levels in the cache."""
        return stored_arrays('levels', digest(
            self._catalog.digest, self._epoch_year,
            [(limit, density) for _, limit, density in self._widths]), self._build)

    @cached_property
    def _every(self) -> LevelCatalog:
        arrays, single = self.stored.arrays, np.zeros(len(self._catalog), bool)
        return LevelCatalog(
            self._catalog.hip, arrays['direction'], arrays['magnitude'], single, single,
            epoch_year=self._epoch_year, levels=arrays['levels'])

    def _build(self) -> dict[str, np.ndarray]:
        direction = self._catalog.directions(self._epoch_year)
        angles = sky_angles(direction)
        bits = np.zeros(len(direction), np.uint32)
        levels, along = dict[str, np.ndarray](), []
        for number, (_, limit, density) in enumerate(self._widths):
            chosen = brightest_everywhere(angles, density)
            chosen[:len(self._catalog.brighter_than(limit))] = True
            star = np.flatnonzero(chosen).astype(np.int32)
            bits[star] |= np.uint32(1 << number)
            # Four in a cell: as fast as one, and smaller.
            cells = cells_along(len(star) / 4, FINE)
            start, order = sorted_by_cell(cell_numbers(direction[star], cells), cells ** 3)
            levels.update({f'start_{number}': start, f'member_{number}': star[order]})
            along.append(cells)
        return {'direction': direction, 'magnitude': self._catalog.magnitude.astype(float),
                'levels': bits, 'cells': np.array(along, np.int32), **levels}
