# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the stars in view will be."""

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens, project, shows
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.prediction import PredictedCentroids
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import sensor_directions
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.motion_models import image_flows
from startracker_ros.core.track.options import TrackerOptions

BORDER_PX = 5.0  # from the edge of the image, where stars are seen in full
SPARE_STARS = 1.5  # per star that is followed: some are blended or too faint


def visible_stars(stars: StarsInView, sky: ApparentCatalog, attitude: AttitudeEstimate,
                  rate_rad_s: np.ndarray, faintest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) and velocities (N, 2) px/s of single stars up to a magnitude."""
    index, direction, matrix = stars.bright(sky, attitude, faintest)
    return _visible(direction, matrix, sky.crowded(index), stars.lens,
                    np.ascontiguousarray(rate_rad_s))


@compiled
def _visible(direction: np.ndarray, matrix: np.ndarray, crowded: np.ndarray, lens: Lens,
             rate_rad_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what visible_stars() does, of stars of direction (N, 3) on ICRF axes."""
    right, bottom = lens.width - 0.5 - BORDER_PX, lens.height - 0.5 - BORDER_PX
    sensor = sensor_directions(matrix, direction)
    uv = project(lens, sensor)
    chosen, count = np.empty(len(uv), np.int64), 0
    for i in range(len(uv)):
        u, v = uv[i]
        if (-0.5 + BORDER_PX <= u <= right and -0.5 + BORDER_PX <= v <= bottom
                and not crowded[i]):
            chosen[count] = i
            count += 1
    chosen = chosen[:count]
    flow, velocity = image_flows(lens, sensor[chosen]), np.zeros((count, 2))
    for i in range(count):
        for axis in range(2):
            for k in range(3):
                velocity[i, axis] += flow[i, axis, k] * rate_rad_s[k]
    return uv[chosen], velocity


def predict_stars(stars: StarsInView, sky: ApparentCatalog, stamp_ns: int,
                  attitude: AttitudeEstimate, rate_rad_s: np.ndarray, options: TrackerOptions
                  ) -> PredictedCentroids:
    """Return the brightest stars in the image at an attitude, and how they move."""
    index, sensor, uv = stars.of(sky, attitude)
    chosen, velocity, sigma_px = _brightest(
        stars.lens, stars.onboard.magnitude[index], sensor, uv, options.magnitude_limit,
        int(SPARE_STARS * options.max_stars), np.ascontiguousarray(attitude.covariance_sensor),
        np.ascontiguousarray(rate_rad_s))
    return PredictedCentroids(stamp_ns, uv[chosen], velocity, sigma_px,
                              stars.onboard.hip[index[chosen]], len(chosen))


@compiled
def _brightest(lens: Lens, magnitude: np.ndarray, sensor: np.ndarray, uv: np.ndarray,
               faintest: float, most: int, covariance: np.ndarray, rate_rad_s: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return which of N stars, brightest first, are in the image, their velocities and errors.

    The velocities (K, 2) in px/s are J w, the errors (K,) in px per axis sqrt(tr(J P J^T) / 2), of
    the covariance P (3, 3) of the attitude.
    """
    chosen, count = np.empty(most, np.int64), 0
    for i in range(np.searchsorted(magnitude, faintest, side='right')):
        if count < most and shows(lens, uv[i, 0], uv[i, 1]):
            chosen[count] = i
            count += 1
    chosen = chosen[:count]
    J = image_flows(lens, sensor[chosen])
    velocity, sigma_px = np.zeros((count, 2)), np.empty(count)
    for i in range(count):
        trace = 0.0
        for axis in range(2):
            for k in range(3):
                velocity[i, axis] += J[i, axis, k] * rate_rad_s[k]
                for m in range(3):
                    trace += J[i, axis, k] * covariance[k, m] * J[i, axis, m]
        sigma_px[i] = np.sqrt(trace / 2)
    return chosen, velocity, sigma_px
