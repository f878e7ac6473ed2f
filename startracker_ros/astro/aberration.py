"""Apparent directions: light deflection by the Sun and aberration, both ways."""

from typing import NamedTuple

import erfa
import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.astro.earth import earth_state

class Vantage(NamedTuple):
    """
    Velocity (3,) in m/s about the barycentre of the solar system, and position (3,) in au.

    Of an observer on ICRS axes; the position is heliocentric.
    """

    velocity_m_s: np.ndarray
    heliocentric_au: np.ndarray


def vantage_near_earth(year: float, velocity_m_s: np.ndarray) -> Vantage:
    """Return the vantage of an observer whose geocentric velocity (3,) is known; EpochError."""
    heliocentric_au, _, earth_m_s = earth_state(year)
    return Vantage(earth_m_s + velocity_m_s, heliocentric_au)


def apparent_directions(directions: np.ndarray, vantage: Vantage) -> np.ndarray:
    """Return the unit vectors (N, 3) that an observer measures of natural ones (N, 3)."""
    return aberrate(deflect(directions, vantage.heliocentric_au), vantage.velocity_m_s)


def natural_directions(apparent: np.ndarray, vantage: Vantage) -> np.ndarray:
    """Return the unit vectors (N, 3) whose apparent_directions() are given, within 0.01 mas."""
    deflected = aberrate(apparent, -vantage.velocity_m_s)
    natural = 2 * deflected - deflect(deflected, vantage.heliocentric_au)
    return natural / np.linalg.norm(natural, axis=1, keepdims=True)


def aberrate(directions: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return apparent unit vectors (N, 3) for an observer at velocity_m_s (3,).

    directions (N, 3) are unit vectors seen by an observer at rest; the opposite velocity is the
    inverse. Special relativity (ERFA, ab, without the potential of the Sun).
    """
    beta = velocity_m_s / SPEED_OF_LIGHT_M_S
    return erfa.ab(directions, beta, np.inf, np.sqrt(1 - beta @ beta))


def deflect(directions: np.ndarray, heliocentric_au: np.ndarray) -> np.ndarray:
    """
    Return unit vectors (N, 3) of stars (N, 3) whose light the Sun deflects (ERFA, ldsun).

    By 0.004 arcsec at a right angle from the Sun, 0.015 arcsec at 30 deg.
    """
    distance_au = np.sqrt(heliocentric_au @ heliocentric_au)
    return erfa.ldsun(directions, heliocentric_au / distance_au, distance_au)
