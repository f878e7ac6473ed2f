"""Circular two-body orbit, geocentric, on axes parallel to ICRF."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from startracker_ros.astro.constants import EARTH_MU_M3_S2


@dataclass(frozen=True)
class CircularOrbit:
    """Orbit of one radius; angles in rad, latitude_rad is the argument of latitude at time 0."""

    radius_m: float
    inclination_rad: float
    node_rad: float
    latitude_rad: float

    @property
    def rate_rad_s(self) -> float:
        """Mean motion, Kepler's third law."""
        return float(np.sqrt(EARTH_MU_M3_S2 / self.radius_m ** 3))

    @property
    def period_s(self) -> float:
        """Time of one revolution."""
        return 2 * np.pi / self.rate_rad_s

    @cached_property
    def node(self) -> np.ndarray:
        """Return the unit vector (3,) to the ascending node."""
        return np.array([np.cos(self.node_rad), np.sin(self.node_rad), 0.0])

    @cached_property
    def normal(self) -> np.ndarray:
        """Return the unit vector (3,) of the orbital angular momentum."""
        tilt = np.sin(self.inclination_rad)
        return np.array([tilt * np.sin(self.node_rad), -tilt * np.cos(self.node_rad),
                         np.cos(self.inclination_rad)])

    @cached_property
    def _ahead(self) -> np.ndarray:
        """Return the unit vector (3,) in the plane, a quarter of a revolution past the node."""
        return np.cross(self.normal, self.node)

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) in m and velocity (3,) in m/s."""
        argument = self.latitude_rad + self.rate_rad_s * time_s
        outward = np.cos(argument) * self.node + np.sin(argument) * self._ahead
        along = np.cos(argument) * self._ahead - np.sin(argument) * self.node
        return self.radius_m * outward, self.radius_m * self.rate_rad_s * along
