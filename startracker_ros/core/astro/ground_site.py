# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera on the ground: its velocity with the Earth, and the air above it."""

from dataclasses import dataclass
import math

import erfa
import numpy as np
from startracker_ros.core.astro.aberration import Air
from startracker_ros.core.astro.constants import DAY_S
from startracker_ros.core.astro.earth import gcrs_from_itrf, julian_date

_SEA_LEVEL_HPA, _SCALE_HEIGHT_M = 1013.25, 8435.0
_RELATIVE_HUMIDITY = 0.5
"""From dry to saturated air refraction changes by 0.1 %."""
_WAVELENGTH_UM = 0.6


@dataclass(frozen=True)
class Site:
    """
    Geodetic latitude and longitude (WGS84, east positive) and height of a camera, and its air.

    pressure_hpa None is that of the standard atmosphere at the height, 0 is without air.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    pressure_hpa: float | None = None
    temperature_c: float = 10.0

    def velocity_m_s(self, year: float, ut1_utc_s: float = 0.0) -> np.ndarray:
        """Return the geocentric velocity (3,) on GCRS axes at a Julian year UTC."""
        return self._state(year, ut1_utc_s)[1]

    def position_m(self, year: float, ut1_utc_s: float = 0.0) -> np.ndarray:
        """Return the geocentric position (3,) on GCRS axes at a Julian year UTC."""
        return self._state(year, ut1_utc_s)[0]

    def _state(self, year: float, ut1_utc_s: float) -> tuple[np.ndarray, np.ndarray]:
        longitude, latitude = np.radians([self.longitude_deg, self.latitude_deg])
        day, fraction = julian_date(year)
        pv = erfa.pvtob(longitude, latitude, self.height_m, 0.0, 0.0, 0.0,
                        erfa.era00(day, fraction + ut1_utc_s / DAY_S))
        axes = erfa.c2i06a(day, fraction).T
        return axes @ np.array(pv['p']), axes @ np.array(pv['v'])

    def zenith(self, year: float, ut1_utc_s: float = 0.0) -> np.ndarray:
        """Return the unit vector (3,) to the geodetic zenith on GCRS axes."""
        longitude, latitude = np.radians([self.longitude_deg, self.latitude_deg])
        local = np.array([math.cos(latitude) * math.cos(longitude),
                          math.cos(latitude) * math.sin(longitude), math.sin(latitude)])
        return gcrs_from_itrf(year, ut1_utc_s) @ local

    def air(self, year: float) -> Air | None:
        """Return the refraction of the air, None without one (ERFA, refco)."""
        pressure_hpa = self.pressure_hpa
        if pressure_hpa is None:
            pressure_hpa = _SEA_LEVEL_HPA * math.exp(-self.height_m / _SCALE_HEIGHT_M)
        if not pressure_hpa:
            return None
        a_rad, b_rad = erfa.refco(
            pressure_hpa, self.temperature_c, _RELATIVE_HUMIDITY, _WAVELENGTH_UM)
        return Air(self.zenith(year), float(a_rad), float(b_rad))
