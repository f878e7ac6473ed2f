"""Hipparcos stars and their directions at a given epoch."""

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from startracker_ros.maths.rotation import ARCSEC

CATALOG_EPOCH_YEAR = 1991.25
"""Julian year of the Hipparcos positions (ESA SP-1200, vol. 1)."""

CATALOG_FILE = Path(__file__).with_name('hipparcos.npz')

_MAS = ARCSEC / 1000


@dataclass(frozen=True)
class StarCatalog:
    """
    Stars by magnitude, brightest first; every array is (N,).

    hip is int32; ra_rad and dec_rad are float64, ICRS at J1991.25; the rest is float32.
    pm_ra_mas_yr holds the factor cos(dec); magnitude is Johnson V.
    """

    hip: np.ndarray
    ra_rad: np.ndarray
    dec_rad: np.ndarray
    pm_ra_mas_yr: np.ndarray
    pm_dec_mas_yr: np.ndarray
    parallax_mas: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    def brighter_than(self, limit: float) -> 'StarCatalog':
        """Return the stars of magnitude up to and including limit."""
        # In float32 like the magnitudes, so that a star exactly at the limit is included.
        count = int(np.searchsorted(self.magnitude, np.float32(limit), side='right'))
        return StarCatalog(*(getattr(self, field.name)[:count] for field in fields(self)))

    def directions(self, epoch_year: float, observer_au: np.ndarray | None = None) -> np.ndarray:
        """
        Return unit vectors (N, 3) in ICRS at a Julian year, seen from a barycentric position (3,).

        Uniform straight motion in space (ESA SP-1200, vol. 1, section 1.5.5) with a radial
        velocity of zero, so the distance cancels. Without a position there is no parallax.
        """
        direction, motion = self._direction_and_motion
        moved = direction + (epoch_year - CATALOG_EPOCH_YEAR) * motion
        if observer_au is not None:
            moved = moved - (_MAS * self.parallax_mas)[:, None] * observer_au
        return moved / np.sqrt(np.einsum('ij,ij->i', moved, moved))[:, None]

    @cached_property
    def _direction_and_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the unit vectors (N, 3) at the catalogue epoch and their rates in rad/yr."""
        sin_ra, cos_ra = np.sin(self.ra_rad), np.cos(self.ra_rad)
        sin_dec, cos_dec = np.sin(self.dec_rad), np.cos(self.dec_rad)
        direction = np.stack([cos_dec * cos_ra, cos_dec * sin_ra, sin_dec], -1)
        east = np.stack([-sin_ra, cos_ra, np.zeros_like(sin_ra)], -1)
        north = np.stack([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec], -1)
        motion = _MAS * (self.pm_ra_mas_yr[:, None] * east + self.pm_dec_mas_yr[:, None] * north)
        return direction, motion


@lru_cache(maxsize=1)
def load_catalog() -> StarCatalog:
    """Return the stars of the package, V <= 9; the arrays are shared and read-only."""
    with np.load(CATALOG_FILE) as columns:
        arrays = [columns[field.name] for field in fields(StarCatalog)]
    for array in arrays:
        array.flags.writeable = False
    return StarCatalog(*arrays)
