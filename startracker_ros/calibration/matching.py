"""Which catalogue stars the centroids of a frame are, once its attitude is known."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.calibration.adjustment import KnownStars
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.maths.rotation import conjugate, rotate


@dataclass(frozen=True)
class View:
    """The centroids of one image and its attitude q_icrf_from_sensor (4,), nearly right."""

    centroids: Centroids
    quaternion: np.ndarray


def match_stars(camera: Camera, places: StarPlaces, views: list[View], quaternions: np.ndarray,
                gate_px: float) -> KnownStars:
    """
    Return the centroids that stand within gate_px of a star, each star and spot once.

    quaternions (F, 4) are the attitudes to go by. Stars disturbed by a neighbour are left out,
    and centroids that are not finite or have no error.
    """
    parts = []
    for frame, (view, q) in enumerate(zip(views, quaternions)):
        spots = view.centroids
        sound = np.flatnonzero(np.isfinite(spots.uv).all(axis=1) & (spots.sigma_px > 0)
                               & np.isfinite(spots.sigma_px))
        near = places.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
        uv = camera.project(rotate(conjugate(q), places.direction[near]))
        shown = camera.contains(uv, -gate_px)
        near, uv = near[shown], uv[shown]
        spot, star = _nearest_pairs(spots.uv[sound], uv, gate_px)
        clear = ~places.crowded[near[star]]
        spot, star = sound[spot[clear]], near[star[clear]]
        parts.append(KnownStars(spots.uv[spot], spots.sigma_px[spot], places.direction[star],
                                np.full(len(spot), frame)))
    return KnownStars(*(np.concatenate([getattr(part, name) for part in parts])
                        for name in ('uv', 'sigma_px', 'icrf', 'frame')))


def _nearest_pairs(a: np.ndarray, b: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of points (N, 2) and (M, 2) that are each other's nearest, within reach."""
    if not len(a) or not len(b):
        return np.empty(0, int), np.empty(0, int)
    distance, to_b = cKDTree(b).query(a, distance_upper_bound=reach)
    to_a = cKDTree(a).query(b)[1]
    found = np.flatnonzero(np.isfinite(distance))
    found = found[to_a[to_b[found]] == found]
    return found, to_b[found]
