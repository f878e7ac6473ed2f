# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of an image of unknown scale: quads of its stars, whatever their size.

The code of a quad (sky_quads.py) does not depend on the scale of the image, so one look-up
searches all fields of view. A quad of the sky with the same code gives the scale, hence the field
of view, and all stars of such a field verify it as in any identification. In wide fields the shape
of a quad depends on its place in the image: one lens after the other is assumed there, and quads
of about its scale are candidates.

Of T candidates tested so far, each has T times the false-alarm probability of a single one. It is
accepted below false_alarm_max over HARMONIC, more than the sum of 1 / T over all tests of an
image.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import islice, pairwise, product
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import load_deep_catalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import (
    Identification, IdentificationOptions, per_centroid)
from startracker_ros.core.identify.star_matcher import usable_stars
from startracker_ros.core.identify.verification import Verifier
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.core.stored_arrays import prepare
from startracker_ros.photographs.ladder import Attempt, chip_ratio, REFERENCE_YEAR
from startracker_ros.photographs.searched_fields import HIGHEST_DEG, LOWEST_DEG
from startracker_ros.photographs.sky_levels import SkyLevels
from startracker_ros.photographs.sky_quads import (
    depths, FEWEST_STARS, image_quads, in_order, matching_neighbours, sky_quads, SkyQuads)

LENS_ERROR = 0.12
"""How far the focal length of the fitted lens may be from that of the quad, as a share."""

LIKELY_DEG = 25.0
"""That of the camera that stands for a photograph of which nothing is known."""

LISTS = 2
_STEP = 1.1
_FIELDS_PER_LEVEL = 2
STARS_PER_FIELD = 30.0
# So wide a field and all narrower ones have one level, of all stars.
_ALL_STARS_DEG = 1.15
# What the images of a level are like; other shapes see some more or fewer of its stars.
_WIDTH, _HEIGHT = 1024, 768
COARSEST_PIXEL_DEG = 0.3
"""Larger pixels resolve no stars."""

HARMONIC = 13.0  # of 200,000 candidates; a hopeless image has some 10,000
ATTEMPTS = 2
"""Searches of one image at most: as it is, and mirrored."""


class _Lens(NamedTuple):
    """
    A lens that is assumed: field of view of the long side, fy / fx, and tolerance of codes.

    The field of a candidate is low to high times that.
    """

    fov_deg: float
    pixel_ratio: float
    tolerance: float
    low: float
    high: float


# Up to this field of view one lens, 10 deg wide, stands for all. Tolerances of codes: an error of
# a pixel in a side of 300 px; of pixels that are not square; of a wide lens half a step off.
_PLANE_DEG, _PLANE_MOST_DEG, _WIDE_STEP = 10.0, 28.0, 1.1
TOLERANCE, _RATIO_TOLERANCE, _WIDE_TOLERANCE = 0.005, 0.01, 0.008
_PLANE = _Lens(_PLANE_DEG, 1.0, TOLERANCE, LOWEST_DEG / _PLANE_DEG, _PLANE_MOST_DEG / _PLANE_DEG)
_WIDE = tuple(_Lens(float(fov_deg), 1.0, _WIDE_TOLERANCE, 1 / _WIDE_STEP, _WIDE_STEP)
              for fov_deg in np.geomspace(_PLANE_MOST_DEG, 118.0, 16))
# Longest sides of the quads of a table in deg, stars in the square of one, and whether deep ones
# and as many everywhere.
_TABLES = ((2.4, 70.0, 3.0, False), (0.3, 2.4, 1.6, True))
# Longest sides of the quads of an image as shares of its field.
_SMALL, _LARGE = 0.15, 0.8
# A star of the image may be so many times as far down the list as one of the table: the others are
# not stars, or out of order. Levels have stars of once to twice the density, and FEWEST_STARS.
_DEPTH = 2.0
# Quads are made of so many of the brightest stars, in turn.
BATCHES, QUICK_BATCHES = (0, 8, 12, 16, 22, 30), (0, 8, 12)
# A lens so wide is not assumed for the last ones. Of 240 simulated fields of 60 to 110 deg, of
# whose 30 spots 10 are stars, 3 are found by them alone; of 80 fields of 35 and 45 deg 13.
_BRIGHT_DEG, _BRIGHT_STARS = 58.0, 22
MOST_CANDIDATES = 50_000  # of one look-up
# Error of an ideal lens; how far the field of a candidate is from that of its level.
_FLOOR_PX, SCALE_ERROR = 1.0, 0.075
# Of which the fourth star of the quad and the order of brightness have up to 8.
LEAST_SUPPORT = 9.0
_SAME_PX = 1.5  # distance of a star in two lists


def _half_tangents() -> np.ndarray:
    """Return the tangents (F,) of half the long side of each field."""
    low, high = np.tan(np.radians([LOWEST_DEG, HIGHEST_DEG]) / 2)
    return np.geomspace(low, high, int(np.ceil(np.log(high / low) / np.log(_STEP))) + 1)


_TANGENTS = _half_tangents()
_ALL_STARS = int(np.searchsorted(_TANGENTS, np.tan(np.radians(_ALL_STARS_DEG) / 2)))
# Levels by field, the narrowest first, and the widest field of each, the widest first.
_LEVEL_STEPS = np.maximum(np.arange(len(_TANGENTS)), _ALL_STARS) // _FIELDS_PER_LEVEL
_WIDEST = [int(np.flatnonzero(step == _LEVEL_STEPS)[-1])
           for step in np.unique(_LEVEL_STEPS)[::-1]]
# The quads of wide fields are of this one and wider ones, which are tested first.
_WIDE_FIELD = int(np.searchsorted(_TANGENTS, np.tan(np.radians(4.5) / 2)))
# Of a lens up to LENS_ERROR wider, and of the distortion that is fitted to it.
_BEYOND = 1.2


class Field(NamedTuple):
    """The camera of a field of view, its catalogue at REFERENCE_YEAR and its verifier."""

    camera: Camera
    onboard: OnboardCatalog
    verifier: Verifier


class Candidates(NamedTuple):
    """
    Image stars (K, 4) of the centroids that may be the stars of the numbers (K, 4).

    found is how many there were before those in another order of brightness were left out.
    """

    centroids: Centroids
    base: np.ndarray
    number: np.ndarray
    found: int = 0


# Candidates by field and pixel ratio.
_OfField = tuple[tuple[int, float], list[Candidates]]


class BlindIdentifier:
    """Identifies images of cameras of any field of view at one epoch."""

    def __init__(self, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions()) -> None:
        """Tables and levels are loaded, or built, when they are first searched."""
        self.years = epoch_year - REFERENCE_YEAR
        self._options = options
        self._deep = cache(load_deep_catalog)
        self._tables: dict[int, tuple[StarCatalog, SkyQuads]] = {}
        self._levels = SkyLevels(self._deep, REFERENCE_YEAR, [
            ideal_camera((_HEIGHT, _WIDTH), _TANGENTS[widest]) for widest in _WIDEST],
            STARS_PER_FIELD)
        self._shape = (0, 0)
        self._fields: dict[tuple[int, float], Field] = {}

    def identify(self, lists: Iterable[Centroids], shape: tuple[int, int]) -> Iterator[Attempt]:
        """Yield each identification of an image of shape (H, W) px."""
        return filter(None, self._identify(lists, shape, BATCHES))

    def identify_in_parts(self, lists: Iterable[Centroids], shape: tuple[int, int]
                          ) -> tuple[Iterator[Attempt], Iterator[Attempt]]:
        """
        Return two iterators over what identify() yields: of the brightest stars, then of all.

        The first part takes a tenth of the time.
        """
        both = self._identify(lists, shape, BATCHES)
        return iter(partial(next, both, None), None), filter(None, both)

    def identify_quickly(self, lists: Iterable[Centroids], shape: tuple[int, int]
                         ) -> Iterator[Attempt]:
        """Yield the results of a short search, of an image that is probably something else."""
        return filter(None, self._identify(lists, shape, QUICK_BATCHES))

    def _identify(self, lists: Iterable[Centroids], shape: tuple[int, int],
                  batches: Sequence[int]) -> Iterator[Attempt | None]:
        """Yield each identification, and None where the stars of a short search end."""
        if shape != self._shape:
            self._shape, self._fields = shape, {}
        tested, seen = 0, StarsSeen(self._options)
        for one_field in self._in_order(lists, seen, batches):
            if one_field is None:
                yield None
                continue
            (number, ratio), candidates = one_field
            field = self._field(number, ratio)
            for one in candidates:
                tested += one.found
                attempt = verified(field, one, seen, tested, self._options, self.years)
                if attempt is not None:
                    attempt = self._resolved(attempt, number)
                    yield attempt
                    # One list may have the stars with too many other spots for a lens.
                    yield from (in_list(attempt, other) for other in islice(lists, LISTS)
                                if other is not one.centroids)

    def _in_order(self, lists: Iterable[Centroids], seen: 'StarsSeen', batches: Sequence[int]
                  ) -> Iterator[_OfField | None]:
        """
        Yield the candidates of each field, and None where the stars of a short search end.

        Narrow fields are the last ones of a short search.
        """
        quick, later = [*pairwise(QUICK_BATCHES)], list[_OfField]()
        for first, last in quick:
            for one in self._of_fields(lists, seen, 0, first, last):
                if one[0][0] >= _WIDE_FIELD:
                    yield one
                else:
                    later.append(one)
        yield from later
        for (first, last), table in product(quick, range(1, len(_TABLES))):
            yield from self._of_fields(lists, seen, table, first, last)
        yield None
        for (first, last), table in product(
                [*pairwise(batches)][len(quick):], range(len(_TABLES))):
            yield from self._of_fields(lists, seen, table, first, last)

    def _of_fields(self, lists: Iterable[Centroids], seen: 'StarsSeen', table: int, first: int,
                   last: int) -> Iterator[_OfField]:
        """Yield the candidates of the quads of a table, of each list the widest field first."""
        # A list is made when it is first used.
        for centroids in islice(lists, LISTS):
            yield from sorted(
                self._candidates(centroids, seen, table, first, last).items(), reverse=True)

    def _candidates(self, centroids: Centroids, seen: 'StarsSeen', table: int, first: int,
                    last: int) -> dict[tuple[int, float], list[Candidates]]:
        """Return the candidates of the quads of a table by field and pixel ratio."""
        found: dict[tuple[int, float], list[Candidates]] = {}
        density = 2 * _DEPTH * _TABLES[table][2]
        height, width = self._shape
        lenses = [lens for lens in _lenses(self._shape, table)
                  if lens.fov_deg < _BRIGHT_DEG or first < _BRIGHT_STARS]
        for lens in lenses:
            camera = ideal_camera(self._shape, np.tan(np.radians(lens.fov_deg) / 2),
                                  lens.pixel_ratio)
            index, direction, _ = seen.by(camera, centroids)
            if len(direction) <= first:
                continue
            catalog, quads = self._table(table)
            tried = image_quads(len(direction), first, last)
            everywhere = _DEPTH * FEWEST_STARS * share_of_sky(camera)
            tried = tried[(seen.depths(centroids, index, tried, height * width) < density)
                          | (tried[:, 3] < everywhere)]
            base, row, ratio = matching_neighbours(
                quads.table, direction, tried, lens.tolerance, lens.low, lens.high,
                MOST_CANDIDATES)
            star = quads.table.star[row]
            number, ordered = catalog.hip[star], in_order(base, star)
            tangent = np.tan(np.radians(np.minimum(lens.fov_deg * ratio, 170.0)) / 2)
            field = np.abs(np.log(tangent[:, None] / _TANGENTS)).argmin(1)
            for chosen in np.unique(field):
                of_field = field == chosen
                mine = of_field & ordered
                found.setdefault((int(chosen), lens.pixel_ratio), []).append(Candidates(
                    centroids, base[mine], number[mine], int(np.count_nonzero(of_field))))
        return found

    def tables(self, camera: Camera) -> Iterator[tuple[StarCatalog, SkyQuads, float]]:
        """Yield what has quads of the size of an image: stars, quads, and depths() up to which."""
        fov_deg = np.degrees(max(camera.fov_x_rad, camera.fov_y_rad))
        for number, (least, most, density, _) in enumerate(_TABLES):
            if least < _LARGE * fov_deg and most > _SMALL * fov_deg:
                yield *self._table(number), 2 * _DEPTH * density

    def catalogue(self, camera: Camera) -> OnboardCatalog:
        """Return the stars of the images of a rectilinear camera."""
        tangent = max(camera.width / camera.fx, camera.height / camera.fy) / 2
        level = _level_of(int(np.abs(np.log(tangent / _TANGENTS)).argmin()))
        return self._levels.resolved(level)

    def wide_quads(self) -> tuple[StarCatalog, SkyQuads]:
        """Return the quads of wide fields, and the catalogue of their stars."""
        return self._table(0)

    def _table(self, number: int) -> tuple[StarCatalog, SkyQuads]:
        if number not in self._tables:
            least, most, density, deep = _TABLES[number]
            catalog = self._deep() if deep else load_catalog()
            self._tables[number] = catalog, sky_quads(
                catalog, REFERENCE_YEAR, least, most, density, even=deep)
        prepare(self._tables[number][1].stored)
        return self._tables[number]

    def _field(self, field: int, pixel_ratio: float) -> Field:
        key = field, pixel_ratio
        if key not in self._fields:
            camera = ideal_camera(self._shape, _TANGENTS[field], pixel_ratio)
            onboard = self._levels.level(_level_of(field))
            self._fields[key] = Field(camera, onboard, Verifier(
                camera, onboard, self._options.tolerance_sigmas, SCALE_ERROR,
                lens_known=False))
        return self._fields[key]

    def _resolved(self, attempt: Attempt, field: int) -> Attempt:
        """Return an attempt with the stars about it as its pixels resolve them."""
        attitude = attempt.identification.attitude
        if attitude is None:
            return attempt
        middle = matrix_from_quaternion(attitude.quaternion)[:, 2]
        onboard = self._levels.about(
            _level_of(field), middle, _BEYOND * attempt.camera.corner_angle_rad)
        return attempt._replace(onboard=onboard.after(self.years))


class StarsSeen:
    """What usable_stars() returns of the lists of one image by ideal lenses, computed once."""

    def __init__(self, options: IdentificationOptions) -> None:
        self._most = options.max_image_stars
        # With the list, so that no other one gets its id.
        self._found: dict[tuple, tuple[Centroids, tuple[np.ndarray, ...]]] = {}
        self._depths: dict[tuple, np.ndarray] = {}

    def by(self, camera: Camera, centroids: Centroids
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rows (N,), directions (N, 3) and errors (N,) of the stars of a list."""
        key = camera.fx, camera.fy, id(centroids)
        if key not in self._found:
            self._found[key] = centroids, usable_stars(camera, centroids, self._most, _FLOOR_PX)
        index, direction, sigma_rad = self._found[key][1]
        return index, direction, sigma_rad

    def depths(self, centroids: Centroids, index: np.ndarray, quads: np.ndarray, area: float
               ) -> np.ndarray:
        """Return the depths (Q,) of quads (Q, 4) of the rows index (N,) of a list."""
        # Most lenses see the same stars.
        key = index.tobytes(), len(quads), quads[:1].tobytes(), id(centroids)
        if key not in self._depths:
            self._depths[key] = depths(centroids.uv[index], quads, area)
        return self._depths[key]


def verified(field: Field, candidates: Candidates, seen: StarsSeen, tested: int,
             options: IdentificationOptions, years: float) -> Attempt | None:
    """Return the best of candidates with the stars so many years later; None if not accepted."""
    _, direction, sigma_rad = seen.by(field.camera, candidates.centroids)
    star = field.onboard.index_of(candidates.number)
    known = (star >= 0).all(1)
    base, number = candidates.base[known], candidates.number[known]
    best, _ = field.verifier.best_of_quads(
        direction, sigma_rad, base, star[known], LEAST_SUPPORT, tested)
    return None if best < 0 else accepted(
        field, Candidates(candidates.centroids, base[best], number[best]), seen, tested, options,
        years)


def accepted(field: Field, candidate: Candidates, seen: StarsSeen, tested: int,
             options: IdentificationOptions, years: float) -> Attempt | None:
    """Return a single candidate, whose arrays are (4,), as verified()."""
    centroids = candidate.centroids
    index, direction, sigma_rad = seen.by(field.camera, centroids)
    match = field.verifier.verify(direction, sigma_rad, candidate.base,
                                  field.onboard.index_of(candidate.number), tested)
    if match.attitude is None or (
            match.false_alarm > options.false_alarm_max / ATTEMPTS / HARMONIC):
        return None
    hip, magnitude, residual_px = per_centroid(
        len(centroids), index, match.star, match.residual_px, field.onboard.hip,
        field.onboard.magnitude)
    return Attempt(
        Identification('identified', f'{match.matched} stars', hip, magnitude, residual_px,
                       match.attitude, match.focal_ratio, match.false_alarm),
        field.camera, field.onboard.after(years), centroids,
        replace(field.camera, fy=field.camera.fx))


def in_list(attempt: Attempt, centroids: Centroids) -> Attempt:
    """Return an identification with the stars of another list of the same image."""
    found = attempt.identification
    known = np.flatnonzero(found.hip)
    apart = np.linalg.norm(centroids.uv[:, None] - attempt.centroids.uv[known], axis=2)
    there = np.flatnonzero(apart.min(0, initial=np.inf) < _SAME_PX)
    here = apart[:, there].argmin(0) if len(there) else there
    hip = np.zeros(len(centroids), np.int32)
    magnitude, residual_px = np.full((2, len(centroids)), np.nan)
    hip[here], magnitude[here], residual_px[here] = (
        column[known[there]] for column in (found.hip, found.magnitude, found.residual_px))
    return attempt._replace(centroids=centroids, identification=replace(
        found, hip=hip, magnitude=magnitude, residual_px=residual_px))


def _lenses(shape: tuple[int, int], table: int) -> tuple[_Lens, ...]:
    """Return the lenses that are assumed of an image of shape (H, W) with a table."""
    height, width = shape
    # Of telescopes all pixels are square.
    others = (*(_PLANE._replace(pixel_ratio=ratio, tolerance=_RATIO_TOLERANCE)
                for ratio in (chip_ratio(width, height) or 0.5, 2.0)), *_WIDE)
    return tuple(lens for lens in (_PLANE, *(() if table else others))
                 if lens.low * lens.fov_deg < COARSEST_PIXEL_DEG * max(shape))


def _level_of(field: int) -> int:
    """Return the level of a field, the first one of the widest."""
    return int(_LEVEL_STEPS[-1] - _LEVEL_STEPS[field])


def ideal_camera(shape: tuple[int, int], tangent: float, pixel_ratio: float = 1.0) -> Camera:
    """Return the ideal camera whose long side has the tangent of half its field."""
    height, width = shape
    focal = max(shape) / 2 / float(tangent)
    return Camera(width, height, focal, focal * pixel_ratio, (width - 1) / 2, (height - 1) / 2)


def share_of_sky(camera: Camera) -> float:
    """Return the share of the sky that an ideal camera sees."""
    x, y = camera.width / 2 / camera.fx, camera.height / 2 / camera.fy
    return float(np.arctan(x * y / np.sqrt(1 + x * x + y * y))) / np.pi
