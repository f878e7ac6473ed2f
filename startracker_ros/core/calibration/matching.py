# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Matching of centroids with catalogue stars at a known attitude."""

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.astro.aberration import apparent_directions, ObserverState
from startracker_ros.core.calibration.adjustment import MatchedStars
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import conjugate, rotate

_FEW_PAIRS = 30_000  # of which all distances are computed faster than two trees are built


@dataclass(frozen=True)
class View:
    """
    The centroids of one image and its approximate attitude q_icrf_from_sensor (4,).

    observer_state is that of the camera, None without aberration.
    """

    centroids: Centroids
    quaternion: np.ndarray
    observer_state: ObserverState | None = None


def match_stars(camera: Camera, onboard: OnboardCatalog, views: list[View],
                quaternions: np.ndarray, gate_px: float) -> MatchedStars:
    """
    Return the pairs of centroids and stars within gate_px, one to one.

    quaternions (F, 4) are the attitudes of the views. Blended stars are excluded, and so are
    centroids that are not finite or have no error.
    """
    parts = []
    for frame, (view, q) in enumerate(zip(views, quaternions)):
        centroids = view.centroids
        valid = np.flatnonzero(np.isfinite(centroids.uv).all(axis=1) & (centroids.sigma_px > 0)
                               & np.isfinite(centroids.sigma_px))
        near = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
        direction = onboard.direction[near]
        if view.observer_state is not None:
            direction = apparent_directions(direction, view.observer_state)
        uv = camera.project(rotate(conjugate(q), direction))
        inside = camera.contains(uv, -gate_px)
        near, uv, direction = near[inside], uv[inside], direction[inside]
        index, star = nearest_pairs(centroids.uv[valid], uv, gate_px)
        single = ~onboard.crowded[near[star]]
        index, star = valid[index[single]], star[single]
        parts.append(MatchedStars(centroids.uv[index], centroids.sigma_px[index],
                                  direction[star], np.full(len(index), frame),
                                  centroids.flux[index], onboard.hip[near[star]],
                                  onboard.magnitude[near[star]]))
    return MatchedStars(*(np.concatenate([getattr(part, field.name) for part in parts])
                          for field in fields(MatchedStars)))


def nearest_pairs(a: np.ndarray, b: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of mutual nearest neighbours within radius, of points (N, 2) and (M, 2)."""
    if not len(a) or not len(b):
        return np.empty(0, int), np.empty(0, int)
    if len(a) * len(b) <= _FEW_PAIRS:
        square = np.square(a[:, :1] - b[:, 0]) + np.square(a[:, 1:] - b[:, 1])
        to_b, to_a = square.argmin(axis=1), square.argmin(axis=0)
        found = np.flatnonzero(square[np.arange(len(a)), to_b] < radius ** 2)
    else:
        distance, to_b = cKDTree(b).query(a, distance_upper_bound=radius)
        to_a = cKDTree(a).query(b)[1]
        found = np.flatnonzero(np.isfinite(distance))
    found = found[to_a[to_b[found]] == found]
    return found, to_b[found]
