# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of an identified frame in ICRF, out of that of the aberrated sky."""

from dataclasses import replace

import numpy as np
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.distortion import plane_points, rays
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.integrity.systematic_errors import with_observer_error
from startracker_ros.core.maths.rotation import conjugate, rotate

_ITERATIONS = 3
"""The focal ratio changes by 1e-4 at most, its effect on the attitude by 1e-8 of that."""


def icrf_identification(found: Identification, centroids: Centroids, camera: Camera,
                        sky: ApparentCatalog, options: IdentificationOptions) -> Identification:
    """
    Return an identification with its attitude and focal ratio fitted to apparent directions.

    Identification itself uses directions without aberration: over a field it changes angles by
    1e-4 of their size at most, which the focal ratio absorbs. Its attitude is that of the
    aberrated sky, off by up to 25.7 arcsec.
    """
    star_index = sky.onboard.index_of(found.hip)
    known = (found.hip > 0) & (star_index >= 0)
    if found.attitude is None or np.count_nonzero(known) < 2:
        return found
    sensor = camera.unproject(centroids.uv[known])
    sigma_rad = camera.pixel_rad * np.hypot(centroids.sigma_px[known], options.sigma_floor_px)
    if sky.observer.state is not None:
        found = _fitted(found, known, sensor, sky.direction(star_index[known]), sigma_rad, camera,
                        options.fov_error_percent / 100)
    assert found.attitude is not None
    return replace(found, attitude=with_observer_error(
        found.attitude, sky.observer, sensor, sigma_rad, sky.motion(star_index[known])))


def _fitted(found: Identification, known: np.ndarray, sensor: np.ndarray, icrf: np.ndarray,
            sigma_rad: np.ndarray, camera: Camera, tolerance: float) -> Identification:
    """
    Return an identification fitted to apparent directions icrf (K, 3) of its known stars (N,).

    sensor (K, 3) are where the camera sees them, with errors sigma_rad (K,).
    """
    equidistant, ratio = camera.model.equidistant, found.focal_ratio
    plane = plane_points(equidistant, sensor)
    for _ in range(_ITERATIONS):
        seen = rays(equidistant, plane / ratio)
        attitude = estimate_attitude(seen, icrf, sigma_rad)
        predicted = plane_points(equidistant, rotate(conjugate(attitude.quaternion), icrf))
        ratio = min(max(_scale(plane, predicted), 1 - tolerance), 1 + tolerance)
    residual_px = found.residual_px.copy()
    residual_px[known] = attitude.residual_rad / camera.pixel_rad
    return replace(found, focal_ratio=ratio, residual_px=residual_px, attitude=attitude)


def _scale(seen: np.ndarray, predicted: np.ndarray) -> float:
    """Return the least-squares scale of points (K, 2) about their mean; association.h says why."""
    p, q = seen - seen.mean(0), predicted - predicted.mean(0)
    return float(np.sum(p * q) / np.sum(q * q))
