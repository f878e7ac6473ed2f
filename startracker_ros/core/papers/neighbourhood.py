# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The star neighbourhood approach (SNA): association by position, or by distances to neighbours.

Samaan, Mortari and Junkins 2005, the baseline of Sadeghi, Sabahi and Saberali.
"""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, quaternion_from_rotation_vector)

GATE_SIGMA = 3 * np.sqrt(2)
"""Radius of a gate, and largest misfit of a distance, in sigma of a centroid per axis: three
times the error of the difference of two centroids."""

NEIGHBOURS_IN_GATE = 2
"""Identified neighbours that must agree to select one of the centroids of a gate."""

NEIGHBOURS_ANYWHERE = 3
"""Identified neighbours that must agree on a star outside its gate: two distances alone fit
its mirror image as well."""


def propagated(camera: Camera, uv: np.ndarray, rate_rad_s: np.ndarray, dt_s: float) -> np.ndarray:
    """Return pixels uv (N, 2) after a turn at rate_rad_s (3,), sensor axes, for dt_s."""
    turn = matrix_from_quaternion(quaternion_from_rotation_vector(np.multiply(rate_rad_s, dt_s)))
    # Row vectors times R are R^T d: the direction after the turn, on the new axes.
    return camera.project(camera.unproject(uv) @ turn)


def star_neighbourhood(camera: Camera, predicted: np.ndarray, icrf: np.ndarray, uv: np.ndarray,
                       sigma_px: np.ndarray) -> np.ndarray:
    """
    Return the index (N,) of each star's centroid, -1 where it is missing or ambiguous.

    predicted (N, 2) px and the catalogue's directions icrf (N, 3) are of the known stars, uv
    (M, 2) px and sigma_px (M,) per axis of the centroids. First the unique pairs: one centroid
    in the gate of one star. Then each star with several centroids in its gate is assigned the
    one that fits the catalogue distances to most of the identified stars best, and each star
    with an empty gate the only one anywhere that fits them.
    """
    assigned = np.full(len(predicted), -1)
    if not len(predicted) or not len(uv):
        return assigned
    radius_px = GATE_SIGMA * np.broadcast_to(sigma_px, len(uv))
    separation = predicted[:, None] - uv
    inside = np.einsum('nmk,nmk->nm', separation, separation) <= radius_px ** 2
    unique = inside & (inside.sum(axis=1, keepdims=True) == 1) & (inside.sum(axis=0) == 1)
    star, centroid = np.nonzero(unique)
    assigned[star] = centroid
    unassigned = np.flatnonzero(assigned < 0)
    if not len(unassigned) or len(star) < NEIGHBOURS_IN_GATE:
        return assigned
    sensor = camera.unproject(uv)
    tolerance_rad = radius_px * camera.pixel_rad / np.sqrt(2)
    free = np.ones(len(uv), bool)
    free[centroid] = False
    # Fewest choices first: each assigned star helps the next. An empty gate leaves all centroids.
    choices = inside[unassigned].sum(axis=1)
    choices[choices == 0] = len(uv) + 1
    for index in unassigned[np.argsort(choices, kind='stable')]:
        in_gate = inside[index].any()
        candidate = np.flatnonzero(free & inside[index] if in_gate else free)
        neighbour = np.flatnonzero(assigned >= 0)
        needed = NEIGHBOURS_IN_GATE if in_gate else NEIGHBOURS_ANYWHERE
        if not len(candidate) or len(neighbour) < needed:
            continue
        beside = assigned[neighbour]
        measured = np.linalg.norm(sensor[candidate, None] - sensor[beside], axis=2)
        known = np.linalg.norm(icrf[index] - icrf[neighbour], axis=1)
        misfit = np.abs(measured - known) / np.hypot(tolerance_rad[candidate, None],
                                                     tolerance_rad[beside])
        # The median misfit, of needed neighbours at least: one of them may be a false star.
        most = max(len(neighbour) // 2, needed - 1)
        misfit = np.partition(misfit, most, axis=1)[:, most]
        fitting = np.count_nonzero(misfit <= 1)
        if fitting == 1 or (fitting and in_gate):
            best = candidate[np.argmin(misfit)]
            assigned[index] = best
            free[best] = False
    return assigned
