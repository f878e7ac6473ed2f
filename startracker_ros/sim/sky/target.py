# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A target satellite on an orbit of its own: its state, direction and brightness."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.astro.bodies import sun_direction
from startracker_ros.core.astro.constants import EARTH_RADIUS_M, SPEED_OF_LIGHT_M_S
from startracker_ros.core.astro.orbit import Elements, propagate, state_from_elements
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.motion_state import MotionState

_STANDARD_RANGE_M = 1e6


@dataclass(frozen=True)
class TargetOptions(Options):
    """Whether there is a target, its orbit at time 0 and its brightness."""

    target: bool = option(False, 'render a target satellite on an orbit of its own, with J2')
    target_altitude_km: float = option(
        1100.0, 'altitude of its perigee above the equatorial radius', unit='km', low=160.0,
        high=100000.0)
    target_eccentricity: float = option(0.0, 'eccentricity of its orbit', low=0.0, high=0.95)
    target_inclination_deg: float = option(30.0, 'inclination of its orbit to the ICRF equator',
                                           unit='deg', low=0.0, high=180.0)
    target_node_deg: float = option(0.0, 'right ascension of its ascending node', unit='deg',
                                    low=-360.0, high=360.0)
    target_perigee_deg: float = option(0.0, 'argument of its perigee', unit='deg', low=-360.0,
                                       high=360.0)
    target_anomaly_deg: float = option(0.0, 'its true anomaly at time 0', unit='deg',
                                       low=-360.0, high=360.0)
    target_magnitude: float = option(
        5.0, 'its V at a range of 1000 km and a phase angle of 90 deg; a Lambert sphere, dark in '
        'the shadow of the Earth', unit='mag', low=-10.0, high=15.0)


@dataclass(frozen=True)
class TargetView:
    """Apparent direction (3,) on ICRF axes, its rate (3,) in rad/s, and V."""

    direction: np.ndarray
    drift_rad_s: np.ndarray
    magnitude: float


class Target:
    """The target of the options; time counts from epoch_year."""

    def __init__(self, options: TargetOptions, epoch_year: float) -> None:
        perigee_m = EARTH_RADIUS_M + 1e3 * options.target_altitude_km
        angles = np.radians([options.target_inclination_deg, options.target_node_deg,
                             options.target_perigee_deg, options.target_anomaly_deg])
        self._start = state_from_elements(Elements(
            perigee_m / (1 - options.target_eccentricity), options.target_eccentricity, *angles))
        self._magnitude = options.target_magnitude
        self._sun = sun_direction(epoch_year)

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) in m and velocity (3,) in m/s."""
        return propagate(*self._start, time_s)

    def seen_from(self, observer: MotionState, time_s: float, *,
                  aberration: bool) -> TargetView | None:
        """
        Return the apparent target; None in the shadow of the Earth or behind the Earth.

        aberration includes the light time.
        """
        position_m, velocity_m_s = self.at(time_s)
        line = position_m - observer.position_m
        if aberration:
            # Uniform motion during the light time is exact to a micrometre.
            delay_s = np.linalg.norm(line) / SPEED_OF_LIGHT_M_S
            line = position_m - velocity_m_s * delay_s - observer.position_m
        range_m = np.linalg.norm(line)
        direction = line / range_m
        if self._in_shadow(position_m) or _occulted(observer.position_m, line):
            return None
        motion_m_s = velocity_m_s - observer.velocity_m_s
        drift_rad_s = (motion_m_s - direction * (direction @ motion_m_s)) / range_m
        phase_rad = np.arccos(np.clip(-direction @ self._sun, -1, 1))
        if aberration:
            direction = aberrate(direction[None], observer.velocity_m_s)[0]
        return TargetView(direction, drift_rad_s, self._magnitude
                          + 5 * np.log10(range_m / _STANDARD_RANGE_M)
                          - 2.5 * np.log10(_phase_function(phase_rad)))

    def _in_shadow(self, position_m: np.ndarray) -> bool:
        """Return whether a position (3,) is in the cylindrical shadow of the Earth."""
        along = position_m @ self._sun
        return bool(along < 0 and position_m @ position_m - along ** 2 < EARTH_RADIUS_M ** 2)


def _occulted(observer_m: np.ndarray, line: np.ndarray) -> bool:
    """Return whether the Earth hides the end of a line (3,) in m from an observer (3,)."""
    fraction = np.clip(-observer_m @ line / (line @ line), 0, 1)
    return bool(np.linalg.norm(observer_m + fraction * line) < EARTH_RADIUS_M)


def _phase_function(phase_rad: float) -> float:
    """Return the brightness of a Lambert sphere at a phase angle, 1 at 90 deg."""
    return max(np.sin(phase_rad) + (np.pi - phase_rad) * np.cos(phase_rad), 1e-6)
