# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated navigation: position and velocity with white noise."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.options import option, Options


@dataclass(frozen=True)
class NavigationOptions(Options):
    """Errors of the simulated navigation, 1 sigma on each axis, and its frame."""

    position_sigma_m: float = option(10.0, 'error of the position in odometry, 1 sigma per axis',
                                     unit='m', low=0.0, high=1e5)
    velocity_sigma_m_s: float = option(
        0.033, 'error of the velocity in odometry, 1 sigma per axis', unit='m/s', low=0.0,
        high=1e3)
    satellite_frame_id: str = option(
        'satellite', 'child frame of odometry: at the satellite, with the axes of the inertial '
        'frame')

    def measured(self, position_m: np.ndarray, velocity_m_s: np.ndarray,
                 rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) and velocity (3,) with noise."""
        return (position_m + rng.normal(0, self.position_sigma_m, 3),
                velocity_m_s + rng.normal(0, self.velocity_sigma_m_s, 3))
