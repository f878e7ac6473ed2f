"""Orbits about the Earth: elements and states, two-body and J2 motion, the orbit frame."""

from dataclasses import dataclass
import math

import numpy as np
from startracker_ros.astro.constants import EARTH_J2, EARTH_MU_M3_S2, EARTH_RADIUS_M
from startracker_ros.compiled import compiled

_STEP_S = 5.0
"""Runge-Kutta step: 0.3 mm an orbit at 700 km."""


class OrbitError(ValueError):
    """A state or elements that belong to no closed orbit; the text says why."""


@dataclass(frozen=True)
class Elements:
    """
    Osculating Keplerian elements, angles in rad; perigee_rad is the argument of perigee.

    On the equator the node is at 0; on a circle perigee_rad is 0, and the anomaly counts
    from the node.
    """

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
    tilt, up = math.sin(elements.inclination_rad), math.cos(elements.inclination_rad)
    ahead = np.array([-node[1] * up, node[0] * up, tilt])
    cosine, sine = math.cos(elements.perigee_rad), math.sin(elements.perigee_rad)
    perigee, aside = cosine * node + sine * ahead, cosine * ahead - sine * node
    cosine, sine = math.cos(elements.true_anomaly_rad), math.sin(elements.true_anomaly_rad)
    parameter_m = a * (1 - e * e)
    radius_m = parameter_m / (1 + e * cosine)
    speed_m_s = math.sqrt(EARTH_MU_M3_S2 / parameter_m)
    return (radius_m * (cosine * perigee + sine * aside),
            speed_m_s * ((e + cosine) * aside - sine * perigee))


def elements_from_state(position_m: np.ndarray, velocity_m_s: np.ndarray) -> Elements:
    """
    Return the elements of position (3,) and velocity (3,); OrbitError for an open orbit.

    Vallado, Fundamentals of Astrodynamics, algorithm RV2COE.
    """
    radius_m = float(np.linalg.norm(position_m))
    momentum = np.cross(position_m, velocity_m_s)
    size = float(np.linalg.norm(momentum))
    energy = float(velocity_m_s @ velocity_m_s) / 2 - EARTH_MU_M3_S2 / radius_m
    if not (size > 0 and energy < 0):
        raise OrbitError(f'position {np.asarray(position_m).tolist()} m with velocity '
                         f'{np.asarray(velocity_m_s).tolist()} m/s: no closed orbit')
    normal, outward = momentum / size, position_m / radius_m
    towards = np.cross(velocity_m_s, momentum) / EARTH_MU_M3_S2 - outward
    eccentricity = float(np.linalg.norm(towards))
    node = np.array([-normal[1], normal[0], 0.0])
    # Below this the direction is that of rounding.
    node = node / np.linalg.norm(node) if np.linalg.norm(node) > 1e-12 else np.array([1.0, 0, 0])
    perigee_rad = _angle(node, towards, normal) if eccentricity > 1e-12 else 0.0
    latitude_rad = _angle(node, outward, normal)
    return Elements(-EARTH_MU_M3_S2 / (2 * energy), eccentricity,
                    math.atan2(math.hypot(normal[0], normal[1]), normal[2]),
                    math.atan2(node[1], node[0]) % (2 * math.pi), perigee_rad,
                    (latitude_rad - perigee_rad) % (2 * math.pi))


def _angle(start: np.ndarray, end: np.ndarray, normal: np.ndarray) -> float:
    """Return the angle in [0, 2 pi) from start to end about the normal."""
    return float(math.atan2(np.cross(start, end) @ normal, start @ end) % (2 * math.pi))


def propagate(position_m: np.ndarray, velocity_m_s: np.ndarray, time_s: float,
              j2: float = EARTH_J2) -> tuple[np.ndarray, np.ndarray]:
    """
    Return position (3,) and velocity (3,) a time later, or earlier where it is negative.

    Gravity of a point and its J2, whose axis is z; j2 = 0 leaves the two-body motion.
    """
    state = np.concatenate([position_m, velocity_m_s]).astype(float)
    steps = max(1, math.ceil(abs(time_s) / _STEP_S))
    _advance(state, time_s / steps, steps, j2)
    return state[:3], state[3:]


@compiled
def _advance(state: np.ndarray, step_s: float, steps: int, j2: float) -> None:
    """Carry state (6,) on by so many steps: Runge and Kutta, fourth order."""
    trial, total, slope = np.empty(6), np.empty(6), np.empty(6)
    for _ in range(steps):
        _slope(state, j2, slope)
        total[:] = slope
        for part, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
            for i in range(6):
                trial[i] = state[i] + part * step_s * slope[i]
            _slope(trial, j2, slope)
            for i in range(6):
                total[i] += weight * slope[i]
        for i in range(6):
            state[i] += step_s / 6 * total[i]


@compiled
def _slope(state: np.ndarray, j2: float, slope: np.ndarray) -> None:
    """Fill slope (6,) with velocity and acceleration (Vallado, equation 8-50 for J2)."""
    radius2 = state[0] ** 2 + state[1] ** 2 + state[2] ** 2
    pull = EARTH_MU_M3_S2 / (radius2 * math.sqrt(radius2))
    flat = 1.5 * j2 * EARTH_RADIUS_M ** 2 / radius2
    rise = 5 * state[2] ** 2 / radius2
    for i in range(3):
        slope[i] = state[3 + i]
        bulge = 3 - rise if i == 2 else 1 - rise
        slope[3 + i] = -pull * state[i] * (1 + flat * bulge)


def orbit_frame(position_m: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return R_icrf_from_orbit (..., 3, 3) of positions (..., 3) and velocities (..., 3).

    x along the velocity, y against the orbital angular momentum, z completes them: to the
    Earth on a circular orbit. A turn about x is roll, about y pitch, about z yaw.
    """
    x = velocity_m_s / np.linalg.norm(velocity_m_s, axis=-1, keepdims=True)
    y = np.cross(velocity_m_s, position_m)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], -1)
