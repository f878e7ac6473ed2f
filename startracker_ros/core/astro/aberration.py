# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Apparent directions: light deflection by the Sun, aberration and refraction."""

from typing import NamedTuple

import erfa
import numpy as np
from startracker_ros.core.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.core.astro.earth import earth_state

_LOWEST_COS = 0.1
"""Cosine of the zenith distance below which refraction no longer grows: 6 deg of elevation."""


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


class ObserverState(NamedTuple):
    """
    Velocity (3,) in m/s about the barycentre of the solar system, and position (3,) in au.

    Of an observer on ICRS axes; the position is heliocentric. air is that above a camera on the
    ground.
    """

    velocity_m_s: np.ndarray
    heliocentric_au: np.ndarray
    air: Air | None = None


def state_near_earth(year: float, velocity_m_s: np.ndarray) -> ObserverState:
    """Return the state of an observer of known geocentric velocity (3,); EpochError."""
    heliocentric_au, _, earth_m_s = earth_state(year)
    return ObserverState(earth_m_s + velocity_m_s, heliocentric_au)


def apparent_directions(directions: np.ndarray, state: ObserverState) -> np.ndarray:
    """Return the unit vectors (N, 3) that an observer measures of natural ones (N, 3)."""
    apparent = aberrate(deflect(directions, state.heliocentric_au), state.velocity_m_s)
    return apparent if state.air is None else refract(apparent, state.air)


def natural_directions(apparent: np.ndarray, state: ObserverState) -> np.ndarray:
    """Return the unit vectors (N, 3) whose apparent_directions() are these; to 1e-6 arcsec."""
    directions = apparent
    for _ in range(_INVERSE_ITERATIONS):
        directions = directions + apparent - apparent_directions(directions, state)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


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
