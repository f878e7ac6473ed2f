# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The orbit of a spacecraft from elements: Keplerian ones, or a two-line element set."""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from sgp4.api import Satrec, SGP4_ERRORS
from startracker_ros.core.astro.constants import DAY_S, EARTH_RADIUS_M, UNIX_JD
from startracker_ros.core.astro.earth import gcrs_from_teme
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.orbit import Elements, OrbitError, propagate, state_from_elements
from startracker_ros.core.options import option, Options

LOWEST_PERIGEE_M = EARTH_RADIUS_M + 100e3
HIGHEST_APOGEE_M = 9.2e8
"""Sphere of influence of the Earth."""

KEPLER_MAX_AGE_S = DAY_S
"""J2 alone leaves some km in a low orbit after a day: 5 m/s."""

TLE_MAX_AGE_S = 7 * DAY_S
"""A set of a low orbit loses 1 to 3 km a day: some 20 m/s after a week."""


@dataclass(frozen=True)
class OrbitOptions(Options):
    """Elements of the orbit of the observer, for where odometry is not published."""

    tle_line_1: str = option('', 'first line of a two-line element set of the spacecraft')
    tle_line_2: str = option('', 'second line of that set')
    orbit_elements: tuple[float, float, float, float, float, float] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 'osculating elements on ICRF axes: semi-major axis in km, '
        'eccentricity, inclination, right ascension of the node, argument of perigee, true '
        'anomaly in deg; zeros for none', low=-1e7, high=1e7)
    orbit_epoch_s: float = option(
        0.0, 'time of orbit_elements, as header stamps count it', unit='s', low=0.0, high=4.2e9)


Velocity = Callable[[int], np.ndarray]
"""Geocentric velocity (3,) in m/s on ICRF axes at a stamp in ns; OrbitError."""


def orbit_velocity(options: OrbitOptions) -> Velocity | None:
    """Return the velocity on the orbit of the options, None without one; OrbitError."""
    if options.tle_line_1 or options.tle_line_2:
        return TwoLineOrbit(options.tle_line_1, options.tle_line_2).velocity_m_s
    if any(options.orbit_elements):
        semi_major_axis_km, eccentricity, *angles_deg = options.orbit_elements
        return KeplerOrbit(
            Elements(semi_major_axis_km * 1e3, eccentricity, *map(math.radians, angles_deg)),
            round(options.orbit_epoch_s * 1e9)).velocity_m_s
    return None


class KeplerOrbit:
    """Osculating elements at a stamp, propagated with J2."""

    def __init__(self, elements: Elements, stamp_ns: int) -> None:
        """Raise OrbitError for elements that are not an orbit about the Earth."""
        a, e = elements.semi_major_axis_m, elements.eccentricity
        state = state_from_elements(elements)
        _check_height(a * (1 - e), a * (1 + e))
        self._epoch_ns = self._stamp_ns = stamp_ns
        self._state = state

    def velocity_m_s(self, stamp_ns: int) -> np.ndarray:
        """Return the velocity (3,) at a stamp; OrbitError more than a day from the epoch."""
        _check_age('orbit_elements', (stamp_ns - self._epoch_ns) * 1e-9, KEPLER_MAX_AGE_S)
        # From the last stamp: a day takes ten thousand steps.
        self._state = propagate(*self._state, (stamp_ns - self._stamp_ns) * 1e-9)
        self._stamp_ns = stamp_ns
        return self._state[1]


class TwoLineOrbit:
    """A two-line element set, propagated by SGP4 (Vallado et al., AIAA 2006-6753)."""

    def __init__(self, line_1: str, line_2: str) -> None:
        """Raise OrbitError for lines that are not an element set of an Earth satellite."""
        for number, line in enumerate((line_1, line_2), 1):
            if len(line) != 69 or line[0] != str(number) or _checksum(line) != line[68]:
                raise OrbitError(f'two-line elements: line {number} is {line!r}, which is not '
                                 '69 characters with their checksum')
        try:
            self._satellite = Satrec.twoline2rv(line_1, line_2)
        except ValueError as error:
            raise OrbitError(f'two-line elements: {error}') from error
        if self._satellite.error:
            raise OrbitError(f'two-line elements: {SGP4_ERRORS[self._satellite.error]}')
        radius_m = self._satellite.radiusearthkm * 1e3
        _check_height((1 + self._satellite.altp) * radius_m,
                      (1 + self._satellite.alta) * radius_m)

    def velocity_m_s(self, stamp_ns: int) -> np.ndarray:
        """Return the velocity (3,) at a stamp; OrbitError more than a week from the epoch."""
        days, fraction = divmod(stamp_ns / (DAY_S * 1e9), 1)
        jd = UNIX_JD + days
        age_days = (jd - self._satellite.jdsatepoch) + (fraction - self._satellite.jdsatepochF)
        _check_age('two-line elements', age_days * DAY_S, TLE_MAX_AGE_S)
        status, _, velocity_km_s = self._satellite.sgp4(jd, fraction)
        if status:
            raise OrbitError(f'two-line elements: {SGP4_ERRORS[status]}')
        return gcrs_from_teme(epoch_year_from_stamp(stamp_ns)) @ velocity_km_s * 1e3


def _checksum(line: str) -> str:
    """Return the last digit of a line of elements: digits add up, a minus counts as one."""
    return str(sum(int(c) if c.isdigit() else c == '-' for c in line[:68]) % 10)


def _check_height(perigee_m: float, apogee_m: float) -> None:
    """Raise OrbitError for an orbit that meets the Earth or leaves its gravity."""
    if not (perigee_m > LOWEST_PERIGEE_M and apogee_m < HIGHEST_APOGEE_M):
        raise OrbitError(f'perigee {perigee_m / 1e3:.0f} km and apogee {apogee_m / 1e3:.0f} km '
                         'from the centre: no orbit about the Earth')


def _check_age(name: str, age_s: float, max_age_s: float) -> None:
    """Raise OrbitError for a stamp too far from the epoch of the elements."""
    if not abs(age_s) <= max_age_s:
        raise OrbitError(f'{name}: their epoch is {abs(age_s) / DAY_S:.1f} days off, '
                         f'{max_age_s / DAY_S:g} are allowed')
