# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pixels of a solved image and the sky, one to the other."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.aberration import (
    apparent_directions, natural_directions, ObserverState)
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import matrix_from_quaternion, rotate

_BEYOND_CORNER = 1.05


@dataclass(frozen=True)
class SkyMapping:
    """
    Pixels of an image to directions on ICRS axes as the catalogue has them, and back.

    quaternion is q_icrf_from_sensor of the optical axis. With an observer_state it was fitted to
    apparent directions, without one to those of the catalogue.
    """

    camera: Camera
    quaternion: np.ndarray
    observer_state: ObserverState | None = None

    @property
    def reach_rad(self) -> float:
        """Angle from the optical axis within which directions have a pixel."""
        return min(_BEYOND_CORNER * self.camera.corner_angle_rad, np.pi)

    def pixels(self, directions: np.ndarray) -> np.ndarray:
        """Return the px (N, 2) of unit vectors (N, 3), NaN for those far outside the image."""
        apparent = directions if self.observer_state is None else apparent_directions(
            directions, self.observer_state)
        sensor = apparent @ matrix_from_quaternion(self.quaternion)
        # Beyond the corners a distortion may fold back into the image.
        beyond = sensor[:, 2] < np.cos(self.reach_rad)
        return np.where(beyond[:, None], np.nan, self.camera.project(sensor))

    def directions(self, pixels: np.ndarray) -> np.ndarray:
        """Return unit vectors (N, 3) of pixels (N, 2)."""
        apparent = rotate(self.quaternion, self.camera.unproject(pixels))
        return apparent if self.observer_state is None else natural_directions(
            apparent, self.observer_state)
