# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of narrow fields with a catalogue of the user, too deep to be held in memory.

As blind.py, quads of image stars are looked up by their code: among the quads near a position,
made of the stars there, or those of the whole sky, which the folder of the catalogue has. What
differs is that no catalogue of all stars of a field of view is in memory. So the candidates are
first weighed by the image stars that a catalogue star of the folder is near to (support.h); for
the best of them the stars about the image are read, and verify it as in any identification.
"""

from collections.abc import Iterable, Iterator
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import CROWD_MAGNITUDES, onboard_catalog
from startracker_ros.core.catalog.sky_grid import SkyGrid
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.verification import Verifier
from startracker_ros.core.maths.rotation import radec_from_unit, unit_from_radec
from startracker_ros.photographs.blind import (
    BATCHES, Candidates, Field, ideal_camera, in_list, LEAST_SUPPORT, LISTS, MOST_CANDIDATES,
    QUICK_BATCHES, SCALE_ERROR, STARS_PER_FIELD, StarsSeen, TOLERANCE, verified)
from startracker_ros.photographs.ladder import Attempt, REFERENCE_YEAR
from startracker_ros.photographs.searched_fields import TILED_HIGHEST_DEG, TILED_LOWEST_DEG
from startracker_ros.photographs.sky_quads import (
    matching_quads, quad_table, quads_of, QuadTable)
from startracker_ros.photographs.tiles import double_precision, QUADS, TiledCatalogue

QUAD_DENSITY = 1.6
"""Stars in the square of the side of the quads of a level, as of the deep tables of blind.py."""

QUAD_INNER = 2
"""Stars that C and D of a quad are from: one quad of a pair A and B. Of the same number of quads
more have all their stars in an image where these are of more pairs."""

# Sides of the quads as shares of the field of view.
_SHORTEST, _LONGEST = 0.22, 0.7
_STEP = 1.1  # of the fields of view that share a camera, below 1 + SCALE_ERROR on either side
_MOST_VERIFIED = 10  # candidates of one look-up and camera
_FEWEST_IN_FIELD = 8.0
# The stars that are read reach beyond the image by this factor.
_BEYOND = 1.1


class Place(NamedTuple):
    """A direction (3,) within a radius of which the middle of an image is."""

    center: np.ndarray
    radius_rad: float

    @classmethod
    def near(cls, ra_deg: float, dec_deg: float, radius_deg: float) -> 'Place':
        """Return that about a right ascension and declination."""
        return cls(unit_from_radec(*np.radians([ra_deg, dec_deg])),
                   float(np.radians(radius_deg)))

    def __str__(self) -> str:
        ra_deg, dec_deg = np.degrees(radec_from_unit(self.center))
        return (f'within {np.degrees(self.radius_rad):g} deg of right ascension {ra_deg:.4g}, '
                f'declination {dec_deg:.4g} deg')


class Fields(NamedTuple):
    """Fields of view of the long side that are searched, in deg."""

    low_deg: float
    high_deg: float


def side_range_deg(fields: Fields) -> tuple[float, float]:
    """Return the least and the longest side of the quads for fields of view."""
    return _SHORTEST * fields.low_deg, _LONGEST * fields.high_deg


class TiledIdentifier:
    """Identifies narrow images at one epoch with the catalogue of a folder."""

    def __init__(self, catalogue: TiledCatalogue, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions()) -> None:
        """Nothing is read yet."""
        self.catalogue = catalogue
        self._years = epoch_year - REFERENCE_YEAR
        self._options = options

    def fields(self, place: Place | None) -> Fields:
        """Return the fields of view that are searched: anywhere those that the quads are for."""
        least_deg = self.catalogue.description['least_deg']
        return Fields(least_deg if place is None else min(least_deg, TILED_LOWEST_DEG),
                      TILED_HIGHEST_DEG)

    def fields_about(self, camera: Camera | None, error: float, place: Place | None
                     ) -> Fields | None:
        """Return those to search of a field known to a share error, None for another one."""
        low_deg, high_deg = self.fields(place)
        if camera is None:
            return self.fields(place)
        fov_deg = float(np.degrees(max(camera.fov_x_rad, camera.fov_y_rad)))
        found = Fields(max(low_deg, fov_deg * (1 - error)), min(high_deg, fov_deg * (1 + error)))
        return found if found.low_deg < found.high_deg else None

    def lack(self, place: Place | None, fields: Fields) -> str:
        """Return what an image of such fields lacks in the catalogue, empty if nothing."""
        folder, description = self.catalogue.folder, self.catalogue.description
        share = description['sky_share']
        if place is None:
            stars = description['stars']
            if not description['quads']:
                return (f'{folder} has no quads of the whole sky: give the position with --near, '
                        'or make it with --blind')
            where = 'on average'
        else:
            stars = len(self.catalogue.rows_near(place.center, place.radius_rad))
            share = _disc(place.radius_rad) / (4 * np.pi)
            where = str(place)
            if not stars:
                return f'{folder} has no stars {where}: take a catalogue of that part of the sky'
        in_field = stars / (share * 4 * np.pi) * np.radians(fields.high_deg) ** 2 * 0.75
        if in_field < _FEWEST_IN_FIELD:
            return (f'{folder}, to {description["faintest"]:.4g} mag, has {in_field:.2g} stars in '
                    f'a field of {fields.high_deg:.3g} deg {where}, some '
                    f'{_FEWEST_IN_FIELD:g} are needed: take a deeper one, or a wider field')
        return ''

    def identify(self, lists: Iterable[Centroids], shape: tuple[int, int], fields: Fields,
                 place: Place | None = None, *, quickly: bool = False) -> Iterator[Attempt]:
        """
        Yield each identification of an image of shape (H, W) px, of fields within fields().

        Without a place the whole sky is searched.
        """
        table, row = self._whole_sky() if place is None else self._about(place, fields)
        if not len(table.code):
            return
        middle_deg = np.sqrt(fields.low_deg * fields.high_deg)
        tangent = np.tan(np.radians(middle_deg) / 2)
        camera = ideal_camera(shape, tangent)
        tested, used, seen = 0, list(islice(lists, LISTS)), StarsSeen(self._options)
        for first, last in pairwise(QUICK_BATCHES if quickly else BATCHES):
            for centroids in used:
                _, direction, _ = seen.by(camera, centroids)
                if len(direction) <= first:
                    continue
                base, quad, ratio = matching_quads(
                    table, direction, first, last, TOLERANCE, fields.low_deg / middle_deg,
                    fields.high_deg / middle_deg, MOST_CANDIDATES)
                star = table.star[quad] if row is None else row[table.star[quad]]
                tested += len(base)
                step = np.rint(np.log(ratio) / np.log(_STEP))
                for one in np.unique(step):
                    mine = step == one
                    for attempt in self._of_camera(
                            ideal_camera(shape, tangent * _STEP ** one), centroids, seen,
                            base[mine], star[mine], tested):
                        yield attempt
                        yield from (in_list(attempt, other) for other in used
                                    if other is not centroids)

    def _of_camera(self, camera: Camera, centroids: Centroids, seen: StarsSeen, base: np.ndarray,
                   star: np.ndarray, tested: int) -> Iterator[Attempt]:
        """Yield what is accepted of the candidates base (K, 4) and rows star (K, 4)."""
        _, direction, sigma_rad = seen.by(camera, centroids)
        support = supports(self.catalogue.grid, direction, sigma_rad, base, star,
                           self._options.tolerance_sigmas, LEAST_SUPPORT)
        best = np.argsort(-support, kind='stable')[:_MOST_VERIFIED]
        for k in best[support[best] > LEAST_SUPPORT]:
            field = self._field(camera, direction[base[k]], star[k])
            attempt = verified(
                field, Candidates(centroids, base[k:k + 1], self.catalogue.numbers(star[k:k + 1])),
                seen, tested, self._options, self._years)
            if attempt is not None:
                yield attempt

    def _field(self, camera: Camera, seen: np.ndarray, star: np.ndarray) -> Field:
        """Return the stars about an image in which the rows star (4,) are seen at (4, 3)."""
        right, bottom = camera.width - 0.5, camera.height - 0.5
        corner = camera.unproject(np.array([[-0.5, -0.5], [right, -0.5], [-0.5, bottom],
                                            [right, bottom]]))
        middle = _unit(seen.mean(0))
        radius_rad = _BEYOND * float(np.arccos(min((corner @ middle).min(), 1.0)))
        center = _unit(self.catalogue.grid.direction[star].astype(float).mean(0))
        row = self.catalogue.rows_near(center, radius_rad)
        area = _disc(radius_rad)
        count = int(np.ceil(STARS_PER_FIELD * area / (camera.fov_x_rad * camera.fov_y_rad)))
        stars = self.catalogue.stars(row)
        limit = float(stars.magnitude[min(count, len(stars)) - 1])
        onboard = onboard_catalog(stars.brighter_than(limit + CROWD_MAGNITUDES), camera,
                                  REFERENCE_YEAR, limit, sky_share=area / (4 * np.pi))
        return Field(camera, onboard, Verifier(
            camera, onboard, self._options.tolerance_sigmas, SCALE_ERROR, lens_known=False))

    def _whole_sky(self) -> tuple[QuadTable, None]:
        return QuadTable(*map(self.catalogue.array, QUADS)), None

    def _about(self, place: Place, fields: Fields) -> tuple[QuadTable, np.ndarray]:
        """Return the quads of the images of a place, and the rows (M,) of their stars."""
        radius_rad = place.radius_rad + np.radians(fields.high_deg)
        row = self.catalogue.rows_near(place.center, radius_rad)
        return quad_table(*quads_of(
            double_precision(self.catalogue.grid.direction[row]), *side_range_deg(fields),
            QUAD_DENSITY, even=True, inner=QUAD_INNER,
            sky_share=_disc(radius_rad) / (4 * np.pi))), row


def _disc(radius_rad: float) -> float:
    """Return the area of a disc on the sky in steradian."""
    return float(2 * np.pi * (1 - np.cos(radius_rad)))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def supports(sky: SkyGrid, image: np.ndarray, sigma: np.ndarray, base: np.ndarray,
             star: np.ndarray, tolerance_sigmas: float, least: float) -> np.ndarray:
    """
    Return the support (K,) of candidates by other image stars, as far as it is beyond least.

    Stars base (K, 4) of image (N, 3), with errors sigma (N,) in rad, are the rows star (K, 4).
    """
    arrays = [np.ascontiguousarray(array, kind) for array, kind in (
        (sky.direction, np.float32), (sky.start, np.int32), (sky.member, np.int32),
        (image, float), (sigma, float), (base, np.int32), (star, np.int32))]
    at = [array.ctypes.data for array in arrays]
    cells = np.array((*at[:3], len(sky.direction), sky.cells), native.STAR_CELLS)
    stars = np.array((*at[3:5], len(sigma), 0), native.IMAGE_STARS)
    found = np.empty(len(base))
    native.call('st_support_in_cells', cells, stars, tolerance_sigmas, at[5], at[6], len(base),
                least, found)
    return found
