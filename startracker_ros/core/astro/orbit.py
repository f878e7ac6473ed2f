# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Orbits about the Earth: Keplerian elements, circular and J2 motion, the orbit frame."""

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from startracker_ros.core.astro.constants import EARTH_J2, EARTH_MU_M3_S2, EARTH_RADIUS_M
from startracker_ros.core.native import GRAVITY, library

_STEP_S = 5.0
"""Runge-Kutta step. The error is 0.3 mm per revolution at 700 km altitude."""


class OrbitError(ValueError):
    """The elements of an open orbit; the text names them."""


@dataclass(frozen=True)
class Elements:
    """Osculating Keplerian elements, angles in rad; perigee_rad is the argument of perigee."""

    semi_major_axis_m: float
    eccentricity: float
    inclination_rad: float
    node_rad: float
    perigee_rad: float
    true_anomaly_rad: float


def state_from_elements(elements: Elements) -> tuple[np.ndarray, np.ndarray]:
    """
    Return position (3,) in m and velocity (3,) in m/s; OrbitError for an open orbit.

    Vallado, Fundamentals of Astrodynamics, algorithm COE2RV.
    """
    a, e = elements.semi_major_axis_m, elements.eccentricity
    if not (a > 0 and 0 <= e < 1):
        raise OrbitError(f'semi-major axis {a:g} m with eccentricity {e:g}: no closed orbit')
    node = np.array([math.cos(elements.node_rad), math.sin(elements.node_rad), 0.0])
    sine, cosine = math.sin(elements.inclination_rad), math.cos(elements.inclination_rad)
    past_node = np.array([-node[1] * cosine, node[0] * cosine, sine])
    # The perifocal axes: p to the perigee, q a right angle past it.
    cosine, sine = math.cos(elements.perigee_rad), math.sin(elements.perigee_rad)
    p, q = cosine * node + sine * past_node, cosine * past_node - sine * node
    cosine, sine = math.cos(elements.true_anomaly_rad), math.sin(elements.true_anomaly_rad)
    parameter_m = a * (1 - e * e)
    radius_m = parameter_m / (1 + e * cosine)
    speed_m_s = math.sqrt(EARTH_MU_M3_S2 / parameter_m)
    return (radius_m * (cosine * p + sine * q), speed_m_s * ((e + cosine) * q - sine * p))


@dataclass(frozen=True)
class CircularOrbit:
    """
    Two-body motion on a circle: exact at any time, without integration.

    Angles in rad; latitude_rad is the argument of latitude at time 0.
    """

    radius_m: float
    inclination_rad: float
    node_rad: float
    latitude_rad: float

    @cached_property
    def rate_rad_s(self) -> float:
        """Mean motion, Kepler's third law."""
        return float(np.sqrt(EARTH_MU_M3_S2 / self.radius_m ** 3))

    @cached_property
    def normal(self) -> np.ndarray:
        """Return the unit vector (3,) of the orbital angular momentum."""
        sine = np.sin(self.inclination_rad)
        return np.array([sine * np.sin(self.node_rad), -sine * np.cos(self.node_rad),
                         np.cos(self.inclination_rad)])

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) in m and velocity (3,) in m/s."""
        return state_from_elements(Elements(
            self.radius_m, 0.0, self.inclination_rad, self.node_rad, 0.0,
            self.latitude_rad + self.rate_rad_s * time_s))


def propagate(position_m: np.ndarray, velocity_m_s: np.ndarray, time_s: float,
              j2: float = EARTH_J2) -> tuple[np.ndarray, np.ndarray]:
    """
    Return position (3,) and velocity (3,) after time_s, which may be negative.

    Gravity of a point mass and its J2, with z as the axis; j2 = 0 is the two-body motion.
    """
    state = np.concatenate([position_m, velocity_m_s], dtype=float)
    steps = max(1, math.ceil(abs(time_s) / _STEP_S))
    gravity = np.array((EARTH_MU_M3_S2, EARTH_RADIUS_M, j2), GRAVITY)
    library().st_propagate_orbit(gravity.ctypes.data, time_s / steps, steps, state.ctypes.data)
    return state[:3], state[3:]


def orbit_frame(position_m: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return R_icrf_from_orbit (..., 3, 3) of positions (..., 3) and velocities (..., 3).

    x is along the velocity, y against the orbital angular momentum, z completes them and
    points to the Earth on a circular orbit. Rotations about x, y, z are roll, pitch, yaw.
    """
    x = velocity_m_s / np.linalg.norm(velocity_m_s, axis=-1, keepdims=True)
    y = np.cross(velocity_m_s, position_m)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], -1)
