# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets, Moon and Sun as seen from the Earth: directions and brightness."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import erfa
import numpy as np
from startracker_ros.core.astro.constants import (
    AU_M, DAY_S, EARTH_RADIUS_M, SPEED_OF_LIGHT_M_S, YEAR_S)
from startracker_ros.core.astro.earth import earth_state, julian_date
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, why_no_date
from startracker_ros.core.maths.rotation import ARCSEC

PLANETS = ('Mercury', 'Venus', 'Mars', 'Jupiter', 'Saturn', 'Uranus', 'Neptune')
BODIES = (*PLANETS, 'Moon', 'Sun')

_SUN, _MOON = BODIES.index('Sun'), BODIES.index('Moon')
_NUMBERS = (1, 2, 4, 5, 6, 7, 8)  # of the planets in ERFA, whose third is the Earth with the Moon
_LIGHT_DAYS_PER_AU = AU_M / SPEED_OF_LIGHT_M_S / DAY_S
_TT_UTC_S = 69.184
"""Since 2017, 27 s less in 1972: the Moon moves by half an arcsecond in a second."""
_ITERATIONS = 2  # of the light time, which changes by 1e-4 of itself in it

# V at 1 au from Sun and Earth, and its change with powers of the phase angle in deg: planets by
# Harris (1961) as in Meeus, Astronomical Algorithms, chapter 41, Saturn without its rings; the
# Moon by Allen, Astrophysical Quantities (1973). The Sun is at phase zero.
_PHASE_MAGNITUDE = np.array([
    [-0.42, 0.0380, -0.000273, 0.000002, 0], [-4.40, 0.0009, 0.000239, -0.00000065, 0],
    [-1.52, 0.016, 0, 0, 0], [-9.40, 0.005, 0, 0, 0], [-8.88, 0, 0, 0, 0], [-7.19, 0, 0, 0, 0],
    [-6.87, 0, 0, 0, 0], [0.23, 0.026, 0, 0, 4e-9]])
_SUN_MAGNITUDE = -26.74
# Of plan94 against JPL ephemerides.
_SERIES_ERROR_RAD = 60 * ARCSEC
# Farthest from the centre of the Earth that an observer of unknown position is: 600 km high.
_UNKNOWN_POSITION_M = EARTH_RADIUS_M + 600e3
STEP_NS = 10 * 10 ** 9
"""Time for which bodies_at() is the same: the Moon moves by 5 arcsec, seen from an orbit by 40."""
# Equatorial radii (IAU Working Group on Cartographic Coordinates, 2015).
_RADIUS_KM = np.array([2440.5, 6051.8, 3396.2, 71492, 60268, 25559, 24764, 1737.4, 695700])


class BodiesInSky(NamedTuple):
    """
    The BODIES in their order: directions (9, 3) in GCRS, V (9,), radii (9,) in rad.

    error_rad (9,) is how far off the directions are at most.
    """

    direction: np.ndarray
    magnitude: np.ndarray
    radius_rad: np.ndarray
    error_rad: np.ndarray

    def reach(self, direction: np.ndarray, radius_rad: float) -> bool:
        """Return whether the light of any body may be within radius_rad of a direction (3,)."""
        reach_rad = np.minimum(self.radius_rad + self.error_rad + radius_rad, np.pi)
        return bool((self.direction @ direction >= np.cos(reach_rad)).any())

    def near(self, direction: np.ndarray, magnitude: np.ndarray, margin_rad: float,
             fainter_mag: float) -> np.ndarray:
        """
        Return whether the light at directions (N, 3) may be that of each body, (N, 9) bool.

        Beyond its disc and error a body reaches margin_rad. One that is fainter than a star by
        more than fainter_mag does not count there; magnitude (N,) is V of the stars, NaN for none.
        """
        reach_rad = np.minimum(self.radius_rad + self.error_rad + margin_rad, np.pi)
        outshone = magnitude[:, None] < self.magnitude - fainter_mag
        return (direction @ self.direction.T >= np.cos(reach_rad)) & ~outshone


def bodies_from_earth(year: float, position_m: np.ndarray | None = None) -> BodiesInSky:
    """
    Return what is seen at a Julian year UTC from the geocentric position (3,) on GCRS axes.

    From the centre of the Earth by default, which is up to 1 deg off for the Moon and 0.5 arcmin
    for Venus. With light time and without aberration, like the directions of the catalogue
    (ERFA, plan94, moon98 and epv00). The planets are within 80 arcsec from the Sun (Saturn), most
    within 10; the Moon within 10 arcsec. EpochError outside 1900 to 2100.
    """
    year += _TT_UTC_S / YEAR_S
    day, fraction = julian_date(year)
    earth_au, _, earth_m_s = earth_state(year)
    observer_au = np.zeros(3) if position_m is None else position_m / AU_M

    def planet(number: int) -> Callable[[float], np.ndarray]:
        return lambda t: np.array(erfa.plan94(day, t, number)['p']) - earth_au

    vectors = [_with_light_time(planet(number), fraction, observer_au) for number in _NUMBERS]
    # The Earth is elsewhere when the light arrives.
    au_per_day = earth_m_s * DAY_S / AU_M
    vectors.append(_with_light_time(
        lambda t: np.array(erfa.moon98(day, t)['p']) + au_per_day * (t - fraction), fraction,
        observer_au))
    vectors.append(-earth_au - observer_au)
    from_observer = np.array(vectors)
    from_sun = (from_observer + observer_au + earth_au)[:-1]
    distance_au = np.linalg.norm(from_observer, axis=-1)
    sun_au = np.linalg.norm(from_sun, axis=-1)
    phase_deg = np.degrees(np.arccos(np.clip(np.einsum(
        'ij,ij->i', from_sun, from_observer[:-1]) / (sun_au * distance_au[:-1]), -1, 1)))
    magnitude = 5 * np.log10(np.append(sun_au, 1.0) * distance_au) + np.append(
        np.einsum('ij,ji->i', _PHASE_MAGNITUDE, phase_deg ** np.arange(5)[:, None]),
        _SUN_MAGNITUDE)
    error_rad = np.full(len(BODIES), _SERIES_ERROR_RAD)
    if position_m is None:
        error_rad += np.arcsin(_UNKNOWN_POSITION_M / AU_M / distance_au)
    return BodiesInSky(from_observer / distance_au[:, None], magnitude,
                       np.arcsin(1e3 * _RADIUS_KM / AU_M / distance_au), error_rad)


def bodies_at(stamp_ns: int, position_m: np.ndarray | None = None) -> BodiesInSky | None:
    """Return bodies_from_earth() within 5 s of a stamp, None for one that is not a date."""
    place = None if position_m is None else tuple(position_m.tolist())
    return _bodies_in_step(stamp_ns // STEP_NS, place)


@lru_cache(maxsize=8)
def _bodies_in_step(step: int, position_m: tuple[float, ...] | None) -> BodiesInSky | None:
    stamp_ns = step * STEP_NS + STEP_NS // 2
    if why_no_date(stamp_ns):
        return None
    return bodies_from_earth(epoch_year_from_stamp(stamp_ns),
                             None if position_m is None else np.array(position_m))


def bright_bodies(year: float, position_m: np.ndarray | None = None
                  ) -> dict[str, tuple[np.ndarray, float]]:
    """
    Return directions (3,) in GCRS and radii in rad of Sun, Moon and, from a position, Earth.

    Arguments and errors are those of bodies_from_earth(); inside the Earth its radius is 90 deg.
    """
    sky = bodies_from_earth(year, position_m)
    found = {name: (sky.direction[index], float(sky.radius_rad[index]))
             for name, index in (('Sun', _SUN), ('Moon', _MOON))}
    if position_m is not None:
        distance_m = float(np.linalg.norm(position_m))
        found['Earth'] = -position_m / distance_m, float(
            np.arcsin(min(EARTH_RADIUS_M / distance_m, 1.0)))
    return found


def _with_light_time(geocentric_au: Callable[[float], np.ndarray], fraction: float,
                     observer_au: np.ndarray) -> np.ndarray:
    """Return the vector (3,) from the observer to where a body was when its light left it."""
    vector = geocentric_au(fraction) - observer_au
    for _ in range(_ITERATIONS):
        light_days = _LIGHT_DAYS_PER_AU * float(np.linalg.norm(vector))
        vector = geocentric_au(fraction - light_days) - observer_au
    return vector


def sun_direction(year: float) -> np.ndarray:
    """Return the unit vector (3,) from the Earth to the Sun in any year, within 10 arcsec."""
    earth_au = np.array(erfa.plan94(*julian_date(year), 3)['p'])
    return -earth_au / np.linalg.norm(earth_au)
