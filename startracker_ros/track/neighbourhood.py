"""
The star neighbourhood approach (SNA): known stars found again by place, or by neighbours.

Samaan, Mortari and Junkins 2005, as Sadeghi, Sabahi and Saberali take it for their baseline.
"""

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import matrix_from_quaternion, quaternion_from_rotation_vector

GATE_SIGMA = 3 * np.sqrt(2)
"""Radius of a gate, and largest misfit of a distance, in sigma of a centroid per axis: three
times the error of the difference of two centroids."""

NEIGHBOURS_IN_GATE = 2
"""Identified neighbours that must agree to tell the centroids of one gate apart."""

NEIGHBOURS_ANYWHERE = 3
"""Identified neighbours that must agree on a star outside its gate: two distances alone fit the
mirror image of its place as well."""


def carried(camera: Camera, uv: np.ndarray, rate_rad_s: np.ndarray, dt_s: float) -> np.ndarray:
    """Return where star images uv (N, 2) are after a turn at rate_rad_s (3,), sensor axes."""
    turn = matrix_from_quaternion(quaternion_from_rotation_vector(np.multiply(rate_rad_s, dt_s)))
    # Row vectors times R are R^T d: the direction after the turn, on the new axes.
    return camera.project(camera.unproject(uv) @ turn)


def star_neighbourhood(camera: Camera, predicted: np.ndarray, icrf: np.ndarray, uv: np.ndarray,
                       sigma_px: np.ndarray) -> np.ndarray:
    """
    Return the index (N,) of each star's centroid, -1 where it is missing or ambiguous.

    predicted (N, 2) px and the catalogue's directions icrf (N, 3) are of the known stars, uv
    (M, 2) px and sigma_px (M,) per axis of the centroids. A centroid that is alone in the
    gate of one star only is that star. Of the centroids left over, in the gate or anywhere
    when it is empty, a star gets the one whose distances to most of the stars identified so
    far are those of the catalogue, if there is just one, or the one that fits best in its gate.
    """
    assigned = np.full(len(predicted), -1)
    if not len(predicted) or not len(uv):
        return assigned
    radius_px = GATE_SIGMA * np.broadcast_to(sigma_px, len(uv))
    gap = predicted[:, None] - uv
    inside = np.einsum('nmk,nmk->nm', gap, gap) <= radius_px ** 2
    sure = inside & (inside.sum(axis=1, keepdims=True) == 1) & (inside.sum(axis=0) == 1)
    star, centroid = np.nonzero(sure)
    assigned[star] = centroid
    waiting = np.flatnonzero(assigned < 0)
    if not len(waiting) or len(star) < NEIGHBOURS_IN_GATE:
        return assigned
    sensor = camera.unproject(uv)
    tolerance_rad = radius_px * camera.pixel_rad / np.sqrt(2)
    free = np.ones(len(uv), bool)
    free[centroid] = False
    # The easier choices come first, whoever is found helps the others: an empty gate means all.
    choices = inside[waiting].sum(axis=1)
    choices[choices == 0] = len(uv) + 1
    for index in waiting[np.argsort(choices, kind='stable')]:
        in_gate = inside[index].any()
        candidate = np.flatnonzero(free & inside[index] if in_gate else free)
        neighbour = np.flatnonzero(assigned >= 0)
        needed = NEIGHBOURS_IN_GATE if in_gate else NEIGHBOURS_ANYWHERE
        if not len(candidate) or len(neighbour) < needed:
            continue
        beside = assigned[neighbour]
        seen = np.linalg.norm(sensor[candidate, None] - sensor[beside], axis=2)
        known = np.linalg.norm(icrf[index] - icrf[neighbour], axis=1)
        misfit = np.abs(seen - known) / np.hypot(tolerance_rad[candidate, None],
                                                 tolerance_rad[beside])
        # What most neighbours agree on, and enough: one of them may be a false star itself.
        most = max(len(neighbour) // 2, needed - 1)
        misfit = np.partition(misfit, most, axis=1)[:, most]
        fitting = np.count_nonzero(misfit <= 1)
        if fitting == 1 or (fitting and in_gate):
            best = candidate[np.argmin(misfit)]
            assigned[index] = best
            free[best] = False
    return assigned
