# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The body rate by the centroids of two frames, before any star is known."""

import numpy as np
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids

BRIGHTEST = 30
MOST_RATE_RAD_S = np.radians(20.0)
LONGEST_S = 1.0
FLUX_RATIO = 1.6  # between two frames of a star
RADIUS_PX = 8.0  # within which stars of a camera that rolls move alike
LEAST_STARS = 6
OUTLIER_PX = 1.0


def rate_between_frames(camera: Camera, before: Centroids, after: Centroids, dt_s: float
                        ) -> np.ndarray | None:
    """
    Return the body rate (3,) rad/s that moves most bright centroids of a frame to the next one.

    The displacement that most pairs of equal flux share finds the pairs, whose displacements are
    J w (dt_s + the difference of their delays), J the image jacobian. None where too few agree.
    """
    if not 0 < dt_s <= LONGEST_S:
        return None
    first, second = (frame.select(np.argsort(-frame.flux)[:BRIGHTEST])
                     for frame in (before, after))
    moved = second.uv - first.uv[:, None]
    ratio = np.abs(np.log(second.flux / first.flux[:, None]))
    reach_px = MOST_RATE_RAD_S * dt_s / camera.pixel_rad
    i, j = np.nonzero((ratio < np.log(FLUX_RATIO))
                      & (np.linalg.norm(moved, axis=-1) < reach_px + RADIUS_PX))
    if len(i) < LEAST_STARS:
        return None
    shift = moved[i, j]
    near = np.linalg.norm(shift - shift[:, None], axis=-1) < RADIUS_PX
    chosen = near[near.sum(axis=1).argmax()]
    i, j, shift = i[chosen], j[chosen], shift[chosen]
    time_s = dt_s + second.delay_s[j] - first.delay_s[i]
    flow = image_jacobian(camera, camera.unproject((first.uv[i] + second.uv[j]) / 2))
    design = flow * time_s[:, None, None]
    while len(i) >= LEAST_STARS:
        rate = np.linalg.lstsq(design.reshape(-1, 3), shift.reshape(-1), rcond=None)[0]
        off_px = np.linalg.norm(design @ rate - shift, axis=-1)
        worst = off_px.argmax()
        if off_px[worst] <= OUTLIER_PX:
            return rate
        i, design, shift = (np.delete(each, worst, axis=0) for each in (i, design, shift))
    return None
