"""The planets as seen from the Earth: directions and brightness."""

import numpy as np
from startracker_ros.astro.constants import AU_M, DAY_S, DAYS_PER_YEAR, SPEED_OF_LIGHT_M_S
from startracker_ros.astro.planets import heliocentric_au

_LIGHT_DAYS_PER_AU = AU_M / SPEED_OF_LIGHT_M_S / DAY_S

PLANETS = ('Mercury', 'Venus', 'Mars', 'Jupiter', 'Saturn', 'Uranus', 'Neptune')

# V at 1 au from Sun and Earth, and its change with powers of the phase angle in deg (Harris
# 1961 as in Meeus, Astronomical Algorithms, chapter 41). Saturn without its rings.
_PHASE_MAGNITUDE = np.array([
    [-0.42, 0.0380, -0.000273, 0.000002], [-4.40, 0.0009, 0.000239, -0.00000065],
    [-1.52, 0.016, 0, 0], [-9.40, 0.005, 0, 0], [-8.88, 0, 0, 0], [-7.19, 0, 0, 0],
    [-6.87, 0, 0, 0]])


def planets_from_earth(year: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return geocentric directions (7, 3) on ICRF axes and V (7,) at a Julian year.

    With light time and without aberration, like the directions of the catalogue. The parallax
    of an observer on the ground or in low orbit, up to half an arcminute (Venus), is left out.
    """
    earth = heliocentric_au(year)[-1]
    light_days = _LIGHT_DAYS_PER_AU * np.linalg.norm(heliocentric_au(year) - earth, axis=-1)
    from_sun = heliocentric_au(year - light_days / DAYS_PER_YEAR)[:-1]
    from_earth = from_sun - earth
    sun_au, earth_au = np.linalg.norm([from_sun, from_earth], axis=-1)
    phase_deg = np.degrees(np.arccos(np.einsum('ij,ij->i', from_sun, from_earth)
                                     / (sun_au * earth_au)))
    magnitude = (5 * np.log10(sun_au * earth_au)
                 + np.einsum('ij,ji->i', _PHASE_MAGNITUDE, phase_deg ** np.arange(4)[:, None]))
    return from_earth / earth_au[:, None], magnitude
