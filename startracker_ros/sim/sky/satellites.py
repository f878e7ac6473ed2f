# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Satellites that cross the field of view: false stars that move."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.rotation import rotate
from startracker_ros.sim.sky.motion_state import Motion


@dataclass(frozen=True)
class SatelliteTraffic:
    """
    A constant number of satellites near the field, each on a great circle of its own.

    When one has crossed the field, a new one enters from a random direction. Each passes within
    half field_rad of the boresight, at rate_rad_s among the stars.
    """

    count: int
    rate_rad_s: float
    field_rad: float
    motion: Motion
    seed: int

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return unit vectors (count, 3) on ICRF axes and their rates (count, 3) in rad/s."""
        states = [self._passing(index, time_s) for index in range(self.count)]
        direction, drift = np.reshape(states, (self.count, 2, 3)).swapaxes(0, 1)
        return direction, drift

    def _passing(self, index: int, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        duration_s = 2 * self.field_rad / self.rate_rad_s
        # The satellites are evenly spaced in time.
        number, phase = divmod(time_s / duration_s + index / self.count, 1)
        since_s = (phase - 0.5) * duration_s
        rng = np.random.default_rng(np.random.SeedSequence(
            self.seed, spawn_key=(index, int(number) % 2 ** 32)))
        course, miss = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5) * self.field_rad
        q = self.motion.at(time_s - since_s).q_icrf_from_sensor
        heading, aside, ahead = rotate(q, np.array([
            [np.cos(course), np.sin(course), 0.0], [-np.sin(course), np.cos(course), 0.0],
            [0.0, 0.0, 1.0]]))
        nearest = np.cos(miss) * ahead + np.sin(miss) * aside
        angle = self.rate_rad_s * since_s
        return (np.cos(angle) * nearest + np.sin(angle) * heading,
                self.rate_rad_s * (np.cos(angle) * heading - np.sin(angle) * nearest))
