"""Apparent directions: light deflection by the Sun, aberration and refraction."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.astro.earth import earth_state
from startracker_ros.compiled import compiled

_LOWEST_COS = 0.1
"""Cosine of the zenith distance below which refraction no longer grows: 6 deg of elevation."""

_SUN_RADIUS_AU = 1.97412574336e-8
"""Schwarzschild radius of the Sun, 2 G M / c^2."""

_LEAST_FROM_SUN = 1e-6
"""Of 1 + e.p: behind the Sun, within 0.1 deg of its centre, no star is seen."""

_INVERSE_ITERATIONS = 4
"""Each reduces the error by a factor of a hundred or more."""


class Air(NamedTuple):
    """
    Refraction A tan z + B tan^3 z at the zenith distance z of natural directions.

    zenith (3,) is a unit vector on ICRS axes.
    """

    zenith: np.ndarray
    a_rad: float
    b_rad: float


class Vantage(NamedTuple):
    """
    Velocity (3,) in m/s about the barycentre of the solar system, and position (3,) in au.

    Of an observer on ICRS axes; the position is heliocentric. air is that above a camera on the
    ground.
    """

    velocity_m_s: np.ndarray
    heliocentric_au: np.ndarray
    air: Air | None = None


def vantage_near_earth(year: float, velocity_m_s: np.ndarray) -> Vantage:
    """Return the vantage of an observer whose geocentric velocity (3,) is known; EpochError."""
    heliocentric_au, _, earth_m_s = earth_state(year)
    return Vantage(earth_m_s + velocity_m_s, heliocentric_au)


def apparent_directions(directions: np.ndarray, vantage: Vantage) -> np.ndarray:
    """Return the unit vectors (N, 3) that an observer measures of natural ones (N, 3)."""
    apparent = _apparent(_rows(directions), vantage.heliocentric_au,
                         vantage.velocity_m_s / SPEED_OF_LIGHT_M_S)
    return apparent if vantage.air is None else refract(apparent, vantage.air)


def natural_directions(apparent: np.ndarray, vantage: Vantage) -> np.ndarray:
    """Return the unit vectors (N, 3) whose apparent_directions() are these; to 1e-6 arcsec."""
    directions = apparent
    for _ in range(_INVERSE_ITERATIONS):
        directions = directions + apparent - apparent_directions(directions, vantage)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


def aberrate(directions: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return apparent unit vectors (N, 3) for an observer at velocity_m_s (3,).

    directions (N, 3) are unit vectors seen by an observer at rest; the opposite velocity is the
    inverse. Special relativity.
    """
    return _aberrated(_rows(directions), velocity_m_s / SPEED_OF_LIGHT_M_S)


def _rows(directions: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(directions, float)


@compiled
def _apparent(directions: np.ndarray, heliocentric_au: np.ndarray, beta: np.ndarray
              ) -> np.ndarray:
    """
    Return directions p (N, 3) deflected by the Sun, then aberrated at velocity / c beta (3,).

    With e the unit vector from the Sun to the observer, at a distance r, and the Schwarzschild
    radius R of the Sun: p + R / r (e - (e.p) p) / (1 + e.p) (Explanatory Supplement, 7.2.4).
    0.004 arcsec at a right angle from the Sun, 0.015 arcsec at 30 deg.
    """
    r = math.sqrt(heliocentric_au[0] ** 2 + heliocentric_au[1] ** 2 + heliocentric_au[2] ** 2)
    e = heliocentric_au / r
    least = _LEAST_FROM_SUN / max(r * r, 1.0)
    deflected = np.empty((len(directions), 3))
    for n in range(len(directions)):
        p = directions[n]
        along = e[0] * p[0] + e[1] * p[1] + e[2] * p[2]
        bend = _SUN_RADIUS_AU / r / max(1 + along, least)
        for i in range(3):
            deflected[n, i] = p[i] + bend * (e[i] - along * p[i])
    return _aberrated(deflected, beta)


@compiled
def _aberrated(directions: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """
    Return directions p (N, 3) as seen by an observer of velocity / c beta (3,).

    p / gamma + (1 + p.beta / (1 + 1 / gamma)) beta, made a unit vector, with
    1 / gamma = sqrt(1 - beta^2) (Explanatory Supplement, 7.2.5).
    """
    root = math.sqrt(1 - (beta[0] ** 2 + beta[1] ** 2 + beta[2] ** 2))
    seen = np.empty((len(directions), 3))
    for n in range(len(directions)):
        p, q = directions[n], seen[n]
        along = 1 + (p[0] * beta[0] + p[1] * beta[1] + p[2] * beta[2]) / (1 + root)
        for i in range(3):
            q[i] = root * p[i] + along * beta[i]
        q /= math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    return seen


def refract(directions: np.ndarray, air: Air) -> np.ndarray:
    """
    Return unit vectors (N, 3) raised towards the zenith by the air.

    z' = z - A tan z - B tan^3 z, with A and B for observed z, hence corrected by one Newton step
    (ERFA, atioq): within 0.1 arcsec down to 15 deg of elevation.
    """
    cosine = directions @ air.zenith
    z = np.maximum(cosine, _LOWEST_COS)
    across = directions - cosine[:, None] * air.zenith
    r = np.sqrt(np.einsum('ij,ij->i', across, across))
    tangent = r / z
    w = air.b_rad * tangent ** 2
    change = (air.a_rad + w) * tangent / (1 + (air.a_rad + 3 * w) / z ** 2)
    along = across / np.maximum(r, 1e-12)[:, None]
    raised = np.cos(change)[:, None] * directions + np.sin(change)[:, None] * (
        r[:, None] * air.zenith - cosine[:, None] * along)
    return raised / np.linalg.norm(raised, axis=1, keepdims=True)
