# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Narrow fields with a deep catalogue of the user: how it is made, images near and anywhere."""

from collections.abc import Iterator, Sequence
from pathlib import Path
import tempfile
import time
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.extras import extra
from startracker_ros.core.maths.rotation import matrix_from_quaternion, random_attitude
from startracker_ros.io.table import Result
from startracker_ros.photographs.blind import LENS_ERROR
from startracker_ros.photographs.photograph import first_lens
from startracker_ros.photographs.searched_fields import TILED_LOWEST_DEG
from startracker_ros.photographs.solve import NEAR_DEG
from startracker_ros.photographs.tiled import Fields, Place, TiledIdentifier
from startracker_ros.photographs.tiles import TiledCatalogue
from startracker_ros.tools.catalogue.build import build_catalogue
from startracker_ros.tools.figures.correctness import is_wrong
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row

WIDTH, HEIGHT, EPOCH_YEAR = 1024, 768, 2026.5
NO_SKY, CATALOGUE = 'no sky', 'catalogue'
FIELDS = {'0.3 deg': 0.3, '0.4 deg': 0.4, '0.6 deg': 0.6}
CASES = (CATALOGUE, *FIELDS, NO_SKY)

_GAIA_YEAR = 2016.0
_NOISE_PX, _MAGNITUDE_SIGMA, _MISSING, _FALSE = 0.3, 0.3, 0.2, 10
# Of the stars of the catalogue; a camera of a longer exposure shows more, which are not in it.
_MOST_STARS, _SHALLOWER_MAG = 60, 0.2
_ENOUGH = 15  # stars of an image of which ten spots are false
# A simulated sky: stars to this G, ten times as many a square degree in the Milky Way as at its
# poles, three fifths more for each magnitude, and proper motions of 10 mas/yr.
_BRIGHTEST, _FAINTEST, _SLOPE, _MOTION_MAS_YR = 4.0, 14.2, 0.36, 10.0
_PLANE_SHARE, _PLANE_RAD = 0.55, np.radians(12.0)
_PIECE = 500_000
_GALACTIC = np.array([[-0.0548756, -0.8734371, -0.4838350], [0.4941094, -0.4448296, 0.7469822],
                      [-0.8676661, -0.1980764, 0.4559838]])
"""ICRS to galactic axes (ESA SP-1200, vol. 1, section 1.5.3)."""


class _Search(NamedTuple):
    """How an image is searched: whether its position and its field of view are known."""

    name: str
    near: bool
    known_field: bool
    most_s: float


_SEARCHES = (_Search('near', True, True, 0.5), _Search('near, any field', True, False, 0.5),
             _Search('blind', False, True, 10.0), _Search('blind, any field', False, False, 10.0))


def simulated_stars(count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return columns (N,) of random stars, with the names of Gaia."""
    latitude = np.where(rng.random(count) < _PLANE_SHARE,
                        np.clip(rng.laplace(0, np.sin(_PLANE_RAD), count), -1, 1),
                        rng.uniform(-1, 1, count))
    longitude, across = rng.uniform(0, 2 * np.pi, count), np.sqrt(1 - latitude ** 2)
    x, y, z = (np.stack([across * np.cos(longitude), across * np.sin(longitude), latitude], -1)
               @ _GALACTIC).T
    # The integral of 10^(slope m), inverted.
    bright = 10 ** (_SLOPE * (_BRIGHTEST - _FAINTEST))
    magnitude = _FAINTEST + np.log10(rng.uniform(bright, 1, count)) / _SLOPE
    motion = rng.normal(0, _MOTION_MAS_YR, (2, count))
    return {'ra': np.degrees(np.arctan2(y, x)) % 360, 'dec': np.degrees(np.arcsin(z)),
            'pmra': motion[0], 'pmdec': motion[1], 'phot_g_mean_mag': magnitude,
            'ref_epoch': np.full(count, _GAIA_YEAR)}


def write_simulated_sky(path: Path, count: int, seed: int) -> None:
    """Write a Parquet file of so many random stars."""
    with extra('parquet', 'pyarrow', 'A simulated catalogue'):
        import pyarrow
        from pyarrow import parquet
    rng, writer = np.random.default_rng(seed), None
    for first in range(0, count, _PIECE):
        table = pyarrow.table(simulated_stars(min(_PIECE, count - first), rng))
        writer = writer or parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()


def run_own_catalogue_bench(*, trials: int, seed: int, stars: int, folder: Path | None = None,
                            only: Sequence[str] = CASES) -> Result:
    """
    Solve trials images of each field of view with a simulated catalogue of so many stars.

    folder is where the catalogue is, or is written and kept, for other runs.
    """
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as temporary:
        where = folder or Path(temporary, 'catalogue')
        if not where.exists():
            rows += _made(Path(temporary, 'sky.parquet'), where, stars, seed)
        identifier = TiledIdentifier(TiledCatalogue(where), EPOCH_YEAR)
        for number, case in enumerate(CASES[1:]):
            if case in only:
                rows += _field_rows(identifier, case, trials, [seed, number])
        made = identifier.catalogue.description
    return Result('bench own-catalogue', rows, {
        'sky': f'{made["stars"]} random stars to G {_FAINTEST:g}, denser towards the Milky Way',
        'blind': f'from {made["least_deg"]:g} deg on, {made["quads"]} quads', 'trials': trials,
        'images': f'{WIDTH} x {HEIGHT} px, random attitudes, noise {_NOISE_PX:g} px and '
                  f'{_MAGNITUDE_SIGMA:g} mag, {_MISSING:.0%} of the stars missing, {_FALSE} false '
                  f'spots, at most {_MOST_STARS} stars',
        'near': f'position known to {NEAR_DEG:g} deg', 'field': 'known to 5 %, or any',
        'times': 'processor time, of what is not solved as well', 'seed': seed,
        'machine': machine()})


def _made(table: Path, folder: Path, stars: int, seed: int) -> Iterator[Row]:
    """Yield what it costs to make a catalogue."""
    write_simulated_sky(table, stars, seed)
    row = build_catalogue([table], folder, least_deg=TILED_LOWEST_DEG).rows[0]
    yield Row(f'{CATALOGUE}: stars', row['stars'], 'stars')
    yield Row(f'{CATALOGUE}: quads', row['quads'], 'quads')
    yield Row(f'{CATALOGUE}: time to make', row['seconds'], 's')
    yield Row(f'{CATALOGUE}: size', row['mb'], 'MB')


def _field_rows(identifier: TiledIdentifier, case: str, trials: int, seed: list[int]
                ) -> Iterator[Row]:
    """Yield how many images are solved in each search, how many wrong, and the times."""
    for search in _SEARCHES:
        rng = np.random.default_rng(seed)
        solved, wrong, time_s, stars = list[bool](), 0, list[float](), list[int]()
        for _ in range(trials):
            fov_deg = FIELDS.get(case, 0.6)
            centroids, q = (image_of_sky(identifier.catalogue, fov_deg, rng) if case in FIELDS
                            else (random_spots(rng), random_attitude(rng)))
            place = _place(q, rng) if search.near else None
            fields = identifier.fields_about(
                Camera.from_fov(WIDTH, HEIGHT, fov_deg) if search.known_field else None, 0.05,
                place)
            # The quads of the whole sky may be for wider fields.
            if fields is None or fields.low_deg > fov_deg:
                break
            start_s = time.process_time()
            found = solve_list(identifier, centroids, fields, place)
            time_s.append(time.process_time() - start_s)
            solved.append(found is not None)
            stars.append(len(centroids) - _FALSE)
            if found is not None:
                wrong += case not in FIELDS or is_wrong(*found, q)
        if not time_s:
            continue
        name = f'{case}, {search.name}'
        if case in FIELDS:
            enough = np.array(stars) >= _ENOUGH
            yield Row(f'{name}: solved', 100 * float(np.mean(solved)), '%')
            yield Row(f'{name}: with {_ENOUGH} stars or more', 100 * float(enough.mean()), '%')
            yield Row(f'{name}: solved, of these', 100 * float(np.mean(
                np.array(solved)[enough])) if enough.any() else np.nan, '%')
        yield Row(f'{name}: wrong', wrong, 'images', exactly=0)
        for which, percentile in (('median', 50), ('p99', 99)):
            yield Row(f'{name}: time, {which}', float(np.percentile(time_s, percentile)), 's',
                      most=search.most_s)


def _place(q: np.ndarray, rng: np.random.Generator) -> Place:
    """Return a place that an image of attitude q (4,) is in, up to NEAR_DEG off."""
    off = matrix_from_quaternion(q) @ np.append(
        rng.normal(0, np.radians(NEAR_DEG) / 3, 2).clip(-np.radians(3.5), np.radians(3.5)), 1)
    return Place(off / np.linalg.norm(off), float(np.radians(NEAR_DEG)))


def image_of_sky(catalogue: TiledCatalogue, fov_deg: float, rng: np.random.Generator
                 ) -> tuple[Centroids, np.ndarray]:
    """Return the centroids of a random field of a catalogue, and the attitude (4,)."""
    camera, q = Camera.from_fov(WIDTH, HEIGHT, fov_deg), random_attitude(rng)
    matrix = matrix_from_quaternion(q)
    stars = catalogue.stars(catalogue.rows_near(matrix[:, 2], camera.corner_angle_rad))
    stars = stars.brighter_than(catalogue.description['faintest'] - _SHALLOWER_MAG)
    uv = camera.project(stars.directions(EPOCH_YEAR) @ matrix)
    seen = np.flatnonzero(camera.contains(uv))[:_MOST_STARS]
    seen = seen[rng.random(len(seen)) >= _MISSING]
    magnitude = stars.magnitude[seen] + rng.normal(0, _MAGNITUDE_SIGMA, len(seen))
    return _centroids(uv[seen] + rng.normal(0, _NOISE_PX, (len(seen), 2)), magnitude, rng), q


def random_spots(rng: np.random.Generator) -> Centroids:
    """Return an image that is not sky."""
    count = int(rng.integers(10, _MOST_STARS))
    uv = rng.uniform(-0.5, [WIDTH - 0.5, HEIGHT - 0.5], (count, 2))
    return _centroids(uv, rng.uniform(10, _FAINTEST, count), rng)


def _centroids(uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator) -> Centroids:
    """Return stars among false spots, which are as bright as any of them."""
    false = rng.uniform(-0.5, [WIDTH - 0.5, HEIGHT - 0.5], (_FALSE, 2))
    low, high = (magnitude.min(), magnitude.max()) if len(magnitude) else (10.0, 14.0)
    magnitude = np.concatenate([magnitude, rng.uniform(low, high, _FALSE)])
    order = np.argsort(magnitude)
    return Centroids(np.vstack([uv, false])[order], 10 ** (-0.4 * (magnitude[order] - 20)),
                     np.full(len(order), 1 / _NOISE_PX), np.full(len(order), _NOISE_PX))


def solve_list(identifier: TiledIdentifier, centroids: Centroids, fields: Fields,
               place: Place | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Return attitude (4,) and covariance (3, 3) of a list of stars, None if not solved."""
    solved, _ = first_lens(identifier.identify([centroids], (HEIGHT, WIDTH), fields, place),
                           LENS_ERROR)
    if solved is None:
        return None
    attitude = solved[1].attitude
    return attitude.quaternion, attitude.covariance_sensor
