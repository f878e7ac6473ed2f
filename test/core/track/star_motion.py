# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of centroids under a steady turn, for the tests of this folder."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from skies import CAMERA, onboard_stars, START_NS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, multiply, quaternion_from_pointing,
    quaternion_from_rotation_vector, rotate)
from startracker_ros.core.track.track_filter import TrackerState, TrackFilter

STEP_NS = 100_000_000


def sky(magnitude_limit: float = 6.0, camera: Camera = CAMERA) -> OnboardCatalog:
    return onboard_stars(camera, 2026.5, magnitude_limit)


@dataclass
class Motion:
    """
    A camera that turns at a constant rate and sees stars with noise.

    The error of a star of magnitude 5 is sigma_px; sigma_per_magnitude is the decimal
    logarithm of the ratio of the next fainter magnitude.
    """

    onboard: OnboardCatalog
    rate_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pointing_deg: tuple[float, float, float] = (84.0, 5.0, 30.0)
    sigma_px: float = 0.1
    sigma_per_magnitude: float = 0.0
    missed: float = 0.0
    false_points: int = 0
    camera: Camera = CAMERA
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.q_start = quaternion_from_pointing(*np.radians(self.pointing_deg))

    def q(self, frame: float) -> np.ndarray:
        turn = np.radians(self.rate_deg_s) * frame * STEP_NS * 1e-9
        return multiply(self.q_start, quaternion_from_rotation_vector(turn))

    def place(self, frame: float, hip: np.ndarray) -> np.ndarray:
        """Return the true positions (N, 2) of stars by Hipparcos number."""
        star = self.onboard.direction[self.onboard.index_of(hip)]
        return self.camera.project(rotate(conjugate(self.q(frame)), star))

    def frame(self, frame: float) -> tuple[int, Centroids, np.ndarray]:
        """Return the stamp, the centroids, brightest first, and their hip, 0 for false ones."""
        q = self.q(frame)
        near = self.onboard.within(rotate(q, [0.0, 0.0, 1.0]), self.camera.corner_angle_rad)
        uv = self.camera.project(rotate(conjugate(q), self.onboard.direction[near]))
        visible = self.camera.contains(uv) & (self.rng.random(len(near)) >= self.missed)
        near, uv = near[visible], uv[visible]
        sigma_px = self.sigma_px * 10 ** (
            self.sigma_per_magnitude * (self.onboard.magnitude[near] - 5))
        uv = uv + self.rng.normal(0, sigma_px[:, None], uv.shape)
        flux = 1e6 * 10 ** (-0.4 * (self.onboard.magnitude[near]
                                    + self.rng.normal(0, 0.1, len(near))))
        false_uv = self.rng.uniform(0, [self.camera.width, self.camera.height],
                                    (self.false_points, 2))
        uv = np.concatenate([uv, false_uv])
        flux = np.append(flux, self.rng.choice(flux, self.false_points))
        hip = np.append(self.onboard.hip[near], np.zeros(self.false_points, int))
        sigma_px = np.append(sigma_px, np.full(self.false_points, self.sigma_px))
        order = np.argsort(-flux)
        centroids = Centroids(uv[order], flux[order], np.full(len(order), 30.0), sigma_px[order])
        return START_NS + int(frame * STEP_NS), centroids, hip[order]


def errors_of(tracker: TrackFilter, frames: Iterable[tuple[int, Centroids, np.ndarray, np.ndarray]]
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return errors (F, 3) and covariances (F, 3, 3) of a tracker that is started again when lost.

    frames are stamp, centroids and their hip, as of Motion.frame(), and the true attitude (4,).
    """
    errors, covariances = [], []
    for stamp_ns, centroids, hip, truth in frames:
        tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, hip)
        elif tracker.attitude is not None:
            attitude = tracker.attitude.attitude
            errors.append(attitude_error(attitude.quaternion, truth))
            covariances.append(attitude.covariance_sensor)
    return np.array(errors), np.array(covariances)
