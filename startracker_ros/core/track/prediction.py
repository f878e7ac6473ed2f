# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the stars in view will be."""

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens, project
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
    return _visible(direction, matrix, sky.crowded(index), stars.camera.lens,
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
    most = slice(int(SPARE_STARS * options.max_stars))
    index, sensor, uv = (column[most] for column in _in_image(
        stars, sky, attitude, options.magnitude_limit))
    flow = image_flows(stars.camera.lens, sensor)
    covariance = flow @ attitude.covariance_sensor @ np.swapaxes(flow, 1, 2)
    return PredictedCentroids(
        stamp_ns, uv, flow @ rate_rad_s,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        stars.onboard.hip[index], len(uv))


def _in_image(stars: StarsInView, sky: ApparentCatalog, attitude: AttitudeEstimate,
              faintest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what stars.of() does, of the stars up to a magnitude in the image."""
    index, sensor, uv = stars.of(sky, attitude)
    bright = np.searchsorted(stars.onboard.magnitude[index], faintest, side='right')
    inside = stars.camera.contains(uv[:bright])
    return index[:bright][inside], sensor[:bright][inside], uv[:bright][inside]
