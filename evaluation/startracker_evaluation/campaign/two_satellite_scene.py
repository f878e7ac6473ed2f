# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Two satellites that observe a target, and random errors of the located target.

Gao and Cui 2016: two satellites in one orbit, 4 deg of true anomaly apart; the attitude is
known as roll, pitch and yaw to the orbit frame, so errors of position and velocity turn the
lines of sight as well.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import Elements, orbit_frame, state_from_elements
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.locate.line_of_sight import LineOfSight
from startracker_ros.core.locate.location import locate, LocationOptions
from startracker_ros.core.locate.triangulation import LOCATED, triangulate
from startracker_ros.core.maths.rotation import (
    ARCSEC, matrix_from_quaternion, quaternion_from_rotation_vector)

# Not printed in the paper; with these its figures come out, see docs/target.md.
# The target is in the direction of Y, the orbit normal next to X: the worst axis and the best.
ALTITUDE_KM, INCLINATION_DEG, NODE_DEG, MIDDLE_DEG = 700.0, 98.2, 85.0, 10.0
CAMERA_PX = 2048
SEPARATION_DEG = 4.0


@dataclass(frozen=True)
class Errors:
    """1 sigma of each source: m, m/s and rad about x, y, z of the orbit frame, and px."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    centroid_px: float = 0.0

    def scaled(self, scale: float) -> 'Errors':
        """Return all sources times scale."""
        return Errors(*(scale * value for value in self.__dict__.values()))

    @property
    def sigma(self) -> np.ndarray:
        """One standard deviation (11,) of position, velocity, attitude and pixel."""
        return np.repeat([*self.__dict__.values()], [3, 3, 1, 1, 1, 2])


SOURCES = {
    'position': Errors(position_m=10.0),
    'velocity': Errors(velocity_m_s=0.033),
    'attitude': Errors(roll_rad=24 * ARCSEC, pitch_rad=24 * ARCSEC),
    'centroid': Errors(centroid_px=0.33)}
ALL = Errors(position_m=10.0, velocity_m_s=0.033, roll_rad=24 * ARCSEC, pitch_rad=24 * ARCSEC,
             centroid_px=0.33)
PERFECT = Errors()


@dataclass(frozen=True)
class Observer:
    """
    A satellite with a camera fixed to its body, which follows the orbit frame.

    position_m and velocity_m_s (3,); body_from_camera (3, 3); uv (2,) px of the target.
    """

    camera: Camera
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    body_from_camera: np.ndarray
    uv: np.ndarray

    def measure(self, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (N, 3) and directions (N, 3) measured with errors (N, 11)."""
        position_m = self.position_m + error[:, :3]
        frame = orbit_frame(position_m, self.velocity_m_s + error[:, 3:6])
        body = self.camera.unproject(self.uv + error[:, 9:]) @ self.body_from_camera.T
        turn = matrix_from_quaternion(quaternion_from_rotation_vector(error[:, 6:9]))
        return position_m, (frame @ turn @ body[..., None])[..., 0]

    def line_of_sight(self, errors: Errors) -> LineOfSight:
        """Return the true line of sight with the covariance that follows from the errors."""
        step = np.repeat([1.0, 1e-3, 1e-6, 1e-2], [3, 3, 3, 2])
        ahead, behind = (np.concatenate(self.measure(sign * np.diag(step)), axis=1)
                         for sign in (1, -1))
        jacobian = ((ahead - behind) / (2 * step[:, None])).T * errors.sigma
        position_m, direction = self.measure(np.zeros((1, 11)))
        return LineOfSight(position_m[0], direction[0], jacobian @ jacobian.T)


@dataclass(frozen=True)
class Scene:
    """
    Two satellites separation_deg apart in one orbit, and the target above their middle.

    By default the errors are as large as the paper's. In PROPORTIONS, nearer and with a coarser
    camera, their ratios are the paper's as well.
    """

    separation_deg: float = SEPARATION_DEG
    target_above_km: float = 390.0
    field_deg: float = 6.0

    @property
    def camera(self) -> Camera:
        """Return the camera of both satellites."""
        return Camera.from_fov(CAMERA_PX, CAMERA_PX, self.field_deg)

    @property
    def axes(self) -> np.ndarray:
        """Return radial, along and cross track (3, 3) of the middle, columns in ICRF."""
        # Axes of the orbit frame: ahead, against the orbit normal, down.
        return orbit_frame(*self._state(0.0))[:, [2, 0, 1]] * [-1, 1, -1]

    @cached_property
    def target_m(self) -> np.ndarray:
        """Return the position (3,) of the target."""
        position_m, _ = self._state(0.0)
        return position_m * (1 + self.target_above_km * 1e3 / np.linalg.norm(position_m))

    @cached_property
    def observers(self) -> tuple[Observer, Observer]:
        """Return both satellites, their cameras pointed close to the target."""
        return self._observer(-self.separation_deg / 2), self._observer(self.separation_deg / 2)

    def _state(self, aside_deg: float) -> tuple[np.ndarray, np.ndarray]:
        return state_from_elements(Elements(
            EARTH_RADIUS_M + ALTITUDE_KM * 1e3, 0.0,
            *np.radians([INCLINATION_DEG, NODE_DEG, 0.0, MIDDLE_DEG + aside_deg])))

    def _observer(self, aside_deg: float) -> Observer:
        position_m, velocity_m_s = self._state(aside_deg)
        frame = orbit_frame(position_m, velocity_m_s)
        line = (self.target_m - position_m) @ frame
        # A pointing error of a degree; image right is cross track.
        axis = line / np.linalg.norm(line) + np.radians([0.6, 0.8, 0.0])
        z = axis / np.linalg.norm(axis)
        y = np.cross(z, [0.0, 1.0, 0.0])
        y = y / np.linalg.norm(y)
        body = np.stack([np.cross(y, z), y, z], -1)
        return Observer(self.camera, position_m, velocity_m_s, body,
                        self.camera.project(line @ body))

    def draw(self, errors: tuple[Errors, Errors], count: int, seed: int, *,
             weighted: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the errors (N, 3) of the located target in m, and their covariances (N, 3, 3).

        Axes are radial, along and cross track of the middle. A seed has the same standard
        normal draws for all errors.
        """
        rng = np.random.default_rng(seed)
        lines = [one.measure(rng.standard_normal((count, 11)) * mine.sigma)
                 for one, mine in zip(self.observers, errors)]
        position_m, direction = (np.stack(part, axis=1) for part in zip(*lines))
        covariance = np.stack([one.line_of_sight(mine).covariance
                               for one, mine in zip(self.observers, errors)])
        status, located_m, covariance_m2, *_ = triangulate(
            position_m, direction, np.repeat(covariance[None], count, axis=0), weighted, 1.0,
            1e-6)
        if not (status == LOCATED).all():
            raise RuntimeError(f'{np.count_nonzero(status != LOCATED)} draws without a position')
        axes = self.axes
        return (located_m - self.target_m) @ axes, axes.T @ covariance_m2 @ axes

    def noise_free_m(self, *, weighted: bool) -> float:
        """Return the error of the located target without any noise."""
        first, second = self.observers
        located = locate(first.line_of_sight(ALL), second.line_of_sight(ALL), LocationOptions(
            solution='weighted' if weighted else 'least_squares'))
        return float(np.linalg.norm(located.position_m - self.target_m))


PROPORTIONS = Scene(target_above_km=250.0, field_deg=9.3)
