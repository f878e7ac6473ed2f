# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hipparcos stars and their directions at a given epoch."""

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from startracker_ros.core.astro.constants import AU_M, YEAR_S
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.stored_arrays import digest

CATALOG_EPOCH_YEAR = 1991.25
"""Julian year of the Hipparcos positions (ESA SP-1200, vol. 1)."""

CATALOG_FILE = Path(__file__).with_name('hipparcos.npz')

RADIAL_VELOCITY_KM_S = {
    439: 25.4, 1475: 11.6, 5336: -97.1, 8102: -16.7, 15510: 87.9, 19849: -42.3, 24186: 245.2,
    32349: -5.5, 36208: 18.2, 38541: -234.2, 54035: -84.7, 54211: 68.9, 57939: -98.2,
    69673: -5.2, 70890: -22.2, 71681: -22.4, 71683: -22.4, 74234: 310.1, 74235: 310.7,
    87937: -110.5, 99461: -129.4, 104214: -65.9, 104217: -64.4, 105090: 20.6, 108870: -40.5,
    114046: 8.8, 117473: -71.1}
"""Stars whose approach changes their proper motion by 0.02 arcsec or more in 60 years (SIMBAD)."""

_MAS = ARCSEC / 1000
_KM_S_PER_AU_YR = AU_M / YEAR_S / 1000


@dataclass(frozen=True)
class StarCatalog:
    """
    Stars by magnitude, brightest first; float32 but for the first three columns.

    Attributes:
        hip: (N,) int32, Hipparcos numbers.
        ra_rad: (N,) float64, right ascension, rad, ICRS at J1991.25.
        dec_rad: (N,) float64, declination, rad, ICRS at J1991.25.
        pm_ra_mas_yr: (N,) proper motion in right ascension times cos(declination), mas/yr.
        pm_dec_mas_yr: (N,) proper motion in declination, mas/yr.
        parallax_mas: (N,) mas.
        magnitude: (N,) Johnson V.
        bp_rp: (N,) colour of Gaia, mag.
        variation_mag: (N,) standard deviation of the brightness of variables, mag; else 0.

    """

    hip: np.ndarray
    ra_rad: np.ndarray
    dec_rad: np.ndarray
    pm_ra_mas_yr: np.ndarray
    pm_dec_mas_yr: np.ndarray
    parallax_mas: np.ndarray
    magnitude: np.ndarray
    bp_rp: np.ndarray
    variation_mag: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    @cached_property
    def digest(self) -> str:
        """Return a digest of the columns."""
        return digest(*(getattr(self, field.name) for field in fields(self)))

    @property
    def parallax_rad(self) -> np.ndarray:
        """Return the parallaxes (N,) in rad."""
        # Some measured ones are negative.
        return _MAS * np.maximum(self.parallax_mas, 0)

    def brighter_than(self, limit: float) -> 'StarCatalog':
        """
        Select bright stars.

        Args:
            limit: Faintest magnitude, V, included.

        Returns:
            `StarCatalog` of these stars.

        """
        # In float32 like the magnitudes, so that a star exactly at the limit is included.
        count = int(np.searchsorted(self.magnitude, np.float32(limit), side='right'))
        return self.rows(slice(count))

    def rows(self, which: np.ndarray | slice) -> 'StarCatalog':
        """Return these rows."""
        return StarCatalog(*(getattr(self, field.name)[which] for field in fields(self)))

    def directions(self, epoch_year: float, observer_au: np.ndarray | None = None) -> np.ndarray:
        """
        Propagate the stars to an epoch.

        Uniform straight motion in space (ESA SP-1200, vol. 1, section 1.5.5), with a radial
        velocity of zero except for RADIAL_VELOCITY_KM_S.

        Args:
            epoch_year: Julian year.
            observer_au: Barycentric position (3,) on ICRF axes, au. Default: no parallax.

        Returns:
            Unit vectors (N, 3) float64 on ICRF axes.

        """
        moved = self._places(epoch_year, observer_au)
        moved /= _lengths(moved)
        return moved

    def changes(self, epoch_year: float, observer_au: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what changes directions() after a Julian year: velocity (N, 3), parallax_rad (N,).

        Both are in units of the distance at epoch_year, the velocity in rad a year, with that
        along the line of sight. From moved_au (3,) farther a star is later seen exactly along
        direction + years * velocity - parallax_rad * moved_au, which is not a unit vector.
        """
        distance = _lengths(self._places(epoch_year, observer_au))
        # The same at all times; there it is not the difference of long ways.
        velocity = self._places(CATALOG_EPOCH_YEAR + 1) - self._places(CATALOG_EPOCH_YEAR)
        return velocity / distance, self.parallax_rad / distance[:, 0]

    @cached_property
    def _sines(self) -> tuple[np.ndarray, ...]:
        """Return sine and cosine (N,) of right ascension and declination."""
        return tuple(of(angle) for angle in (self.ra_rad, self.dec_rad) for of in (np.sin, np.cos))

    def _places(self, epoch_year: float, observer_au: np.ndarray | None = None) -> np.ndarray:
        """Return the vectors (N, 3) of directions(), in units of the distance at J1991.25."""
        sin_ra, cos_ra, sin_dec, cos_dec = self._sines
        years = epoch_year - CATALOG_EPOCH_YEAR
        east = years * _MAS * self.pm_ra_mas_yr
        north = years * _MAS * self.pm_dec_mas_yr
        # The direction at the catalogue epoch, and the way to the east and to the north.
        outward = cos_dec - north * sin_dec
        moved = np.empty((len(self), 3))
        moved[:, 0] = outward * cos_ra - east * sin_ra
        moved[:, 1] = outward * sin_ra + east * cos_ra
        moved[:, 2] = sin_dec + north * cos_dec
        # In units of the distance at the catalogue epoch, which is 1 / parallax in au.
        parallax_rad = self.parallax_rad
        approaching = np.flatnonzero(np.isin(self.hip, [*RADIAL_VELOCITY_KM_S]))
        for row in approaching:
            au_yr = RADIAL_VELOCITY_KM_S[int(self.hip[row])] / _KM_S_PER_AU_YR
            at_epoch = (cos_dec[row] * cos_ra[row], cos_dec[row] * sin_ra[row], sin_dec[row])
            moved[row] += years * au_yr * parallax_rad[row] * np.array(at_epoch)
        if observer_au is not None:
            moved -= parallax_rad[:, None] * observer_au
        return moved


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (N, 1) of vectors (N, 3)."""
    return np.sqrt(np.einsum('ij,ij->i', vectors, vectors))[:, None]


@lru_cache(maxsize=1)
def load_catalog() -> StarCatalog:
    """
    Load the Hipparcos stars of the package, to V 9.

    Returns:
        `StarCatalog`; its arrays are shared and read-only.

    """
    with np.load(CATALOG_FILE) as columns:
        arrays = [columns[field.name] for field in fields(StarCatalog)]
    for array in arrays:
        array.flags.writeable = False
    return StarCatalog(*arrays)
