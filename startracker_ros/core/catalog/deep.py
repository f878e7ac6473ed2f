# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The deep catalogue: Hipparcos, and all other stars to V 11 with the positions of Gaia DR3.

A Hipparcos star keeps its HIP number. A star without one has the number NUMBER_OFFSET + n, n its
row in the shipped file. Terms of the data: LICENSE in this folder.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions, catalog_in_band
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.stored_arrays import digest, stored_arrays

DEEP_FILE = Path(__file__).with_name('deep.npz')

DEEP_LIMIT = 11.0
"""V to which the deep catalogue is complete; redder stars of Gaia to G 10 go beyond."""

NUMBER_OFFSET = 200_000
"""Above every HIP number (at most 120416)."""

TILED_OFFSET = 100_000_000
"""The number of a star of tiles.py is this and its row."""

HIPPARCOS_COMPLETE_V = 8.0
"""Hipparcos is complete to V 7.3 to 9, depending on latitude and colour (ESA SP-1200, vol. 1)."""

NARROW_FIELD_STARS = 20.0
"""A field with fewer Hipparcos stars to HIPPARCOS_COMPLETE_V on average needs the deep stars."""

# Steps of the integers in the file: positions in mas, proper motions in mas/yr (Barnard's star
# fits into 16 bits), V and colours in mag; height of the zones by which the stars are sorted.
POSITION_STEP_MAS = 4.0
MOTION_STEP_MAS_YR = 0.4
MAGNITUDE_STEP = 0.01
COLOUR_STEP = 0.02
ZONE_DEG = 0.25

_STEPS = {'pm_ra_mas_yr': MOTION_STEP_MAS_YR, 'pm_dec_mas_yr': MOTION_STEP_MAS_YR,
          'magnitude': MAGNITUDE_STEP, 'bp_rp': COLOUR_STEP}
_STEP_RAD = POSITION_STEP_MAS / 1000 * ARCSEC


def star_name(number: int) -> str:
    """
    Return the name of a star: HIP with its number, or without one its position.

    That is J2000 hours, minutes and seconds of right ascension, degrees, minutes and seconds of
    declination, cut off as in the names of surveys; of a catalogue of the user it is the row.
    """
    if number < NUMBER_OFFSET:
        return f'HIP {number}'
    if number >= TILED_OFFSET:
        return f'row {number - TILED_OFFSET} of the catalogue'
    return _position_name(number)


@cache
def _position_name(number: int) -> str:
    catalog = _deep_catalog()
    star = int(np.flatnonzero(catalog.hip == number)[0])
    x, y, z = catalog.rows(slice(star, star + 1)).directions(2000.0)[0].tolist()
    # A tenth of a second and a second are no finer than the positions.
    ra = int(np.degrees(np.arctan2(y, x)) % 360 * 2400)
    dec = int(abs(np.degrees(np.arcsin(z))) * 3600)
    return (f'J{ra // 36000:02d}{ra // 600 % 60:02d}{ra % 600 / 10:04.1f}'
            f'{"-" if z < 0 else "+"}{dec // 3600:02d}{dec // 60 % 60:02d}{dec % 60:02d}')


def camera_catalog(camera: Camera, deep: Callable[[], StarCatalog] | None = None, *,
                   band: BandOptions = BandOptions()) -> StarCatalog:
    """
    Return the stars for a camera: Hipparcos, or for a narrow field the deep catalogue.

    deep returns the latter where the caller has loaded it already; band is that of the
    magnitudes.
    """
    hipparcos = load_catalog()
    share = camera.fov_x_rad * camera.fov_y_rad / (4 * np.pi)
    in_field = share * len(hipparcos.brighter_than(HIPPARCOS_COMPLETE_V))
    stars = hipparcos if in_field >= NARROW_FIELD_STARS else (deep or load_deep_catalog)()
    return catalog_in_band(stars, band)


@cache
def _deep_catalog() -> StarCatalog:
    """Return the deep catalogue, kept for the names of its stars."""
    return load_deep_catalog()


def load_deep_catalog() -> StarCatalog:
    """
    Return the stars of Hipparcos and of DEEP_FILE, 40 MB mapped from the cache.

    V of a double of Hipparcos is that of one star, where the other one is in DEEP_FILE.
    """
    hipparcos = load_catalog()

    def build() -> dict[str, np.ndarray]:
        with np.load(DEEP_FILE) as packed:
            deep = unpack(dict(packed))
            component, magnitude = packed['component'], packed['component_magnitude']
        _, here, there = np.intersect1d(hipparcos.hip, component, return_indices=True)
        single = hipparcos.magnitude.copy()
        single[here] = MAGNITUDE_STEP * magnitude[there]
        stars = replace(hipparcos, magnitude=single)
        order = np.argsort(np.concatenate([stars.magnitude, deep['magnitude']]),
                           kind='stable')
        return {name: np.concatenate([getattr(stars, name), values])[order]
                for name, values in deep.items()}
    key = digest(hipparcos.digest, np.frombuffer(DEEP_FILE.read_bytes(), np.uint8))
    catalog = StarCatalog(**stored_arrays('catalogue', key, build).arrays)
    # Otherwise computed when first used, which reads all of it.
    vars(catalog).update(digest=key)
    return catalog


def pack(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """
    Return the arrays of DEEP_FILE from columns (N,) of StarCatalog, hip 0 for none.

    Rows are in zones of declination, in each by right ascension. Integers are stored as
    differences along a zone and byte by byte, most significant last: this compresses to 8 bytes
    a star.
    """
    ra = np.rint(columns['ra_rad'] / _STEP_RAD).astype(np.int64)
    dec = np.rint((columns['dec_rad'] + np.pi / 2) / _STEP_RAD).astype(np.int64)
    zone = dec // _zone_steps()
    order = np.lexsort((dec, ra, zone))
    ra, dec, zone = ra[order], dec[order], zone[order]
    along = np.diff(ra, prepend=0)
    along[np.diff(zone, prepend=-1) != 0] = ra[np.diff(zone, prepend=-1) != 0]
    with_hip = np.flatnonzero(columns['hip'][order])
    packed = {
        'zone_count': np.bincount(zone, minlength=round(180 / ZONE_DEG) + 1).astype(np.int32),
        'along': _planes(along.astype(np.uint32)),
        'across': _planes((dec % _zone_steps()).astype(np.uint32)),
        'hip_row': with_hip.astype(np.int32),
        'hip': columns['hip'][order][with_hip].astype(np.int32),
        'parallax_mas': columns['parallax_mas'][order][with_hip].astype(np.float32)}
    for name, step in _STEPS.items():
        packed[name] = _planes(np.rint(columns[name][order] / step).astype(np.int16))
    return packed


def unpack(packed: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns (N,) of StarCatalog from the arrays of DEEP_FILE."""
    count = packed['zone_count']
    zone = np.repeat(np.arange(len(count)), count)
    along = _joined(packed['along'], np.uint32).astype(np.int64)
    total = np.cumsum(along)
    begin = np.cumsum(count) - count
    # The sum of all zones before each one.
    before = np.concatenate([[0], total])[begin]
    ra_rad = (total - np.repeat(before, count)) * _STEP_RAD
    dec_rad = ((zone * _zone_steps() + _joined(packed['across'], np.uint32)) * _STEP_RAD
               - np.pi / 2)
    number = np.arange(len(zone), dtype=np.int32) + NUMBER_OFFSET
    number[packed['hip_row']] = packed['hip']
    parallax_mas = np.zeros(len(zone), np.float32)
    parallax_mas[packed['hip_row']] = packed['parallax_mas']
    columns = {'hip': number, 'ra_rad': ra_rad, 'dec_rad': dec_rad, 'parallax_mas': parallax_mas}
    for name, step in _STEPS.items():
        columns[name] = (_joined(packed[name], np.int16) * step).astype(np.float32)
    columns['variation_mag'] = np.zeros(len(zone), np.float32)
    return columns


def _zone_steps() -> int:
    return round(ZONE_DEG * 3600 * 1000 / POSITION_STEP_MAS)


def _planes(values: np.ndarray) -> np.ndarray:
    """Return the bytes (B, N) of integers (N,), the least significant first."""
    return np.ascontiguousarray(
        values.astype(values.dtype.newbyteorder('<')).view(np.uint8).reshape(len(values), -1).T)


def _joined(planes: np.ndarray, dtype: type) -> np.ndarray:
    """Return the integers (N,) of their bytes (B, N)."""
    little = np.dtype(dtype).newbyteorder('<')
    return np.ascontiguousarray(planes.T).view(little)[:, 0].astype(dtype)
