# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Catalogue stars without a track, found among the centroids by the attitude."""

import math

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens, plane_point
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.sorting import insert_sorted
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.motion_models import image_flow

GATE_SIGMA = 4.0
"""Below rotation_fit.OUTLIER_SIGMA, so that a new star is no outlier in the next frame."""

VARIABLE_SIGMAS = 2.0
"""Of the brightness of a variable: a sine has its extremes at 1.4."""

MAX_DISTANCE_PX = 5.0
"""Largest gate, whatever the covariance of the attitude."""


def match_new_stars(stars: StarsInView, sky: ApparentCatalog, attitude: AttitudeEstimate,
                    uv: np.ndarray, flux: np.ndarray, sigma_px: np.ndarray, zero_point: float,
                    magnitude_tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return catalogue indices (K,) and centroid indices (K,) of unambiguous pairs.

    uv (M, 2) px, flux (M,) DN and sigma_px (M,) per axis are of the centroids; zero_point is the
    magnitude of 1 DN. A pair agrees in position and magnitude, and neither of the two agrees with
    any other. Of a variable star the magnitude may be off by VARIABLE_SIGMAS more. A crowded star
    makes pairs ambiguous and is in none itself.
    """
    onboard = stars.onboard
    uv, flux, sigma_px = map(np.ascontiguousarray, (uv, flux, sigma_px))
    near, sensor, star_uv = stars.beside(sky, attitude, uv, MAX_DISTANCE_PX)
    star_index, centroid = _match(
        near, sensor, star_uv, onboard.magnitude, onboard.crowded, uv, flux, sigma_px,
        np.ascontiguousarray(attitude.covariance_sensor), stars.camera.lens, zero_point,
        magnitude_tolerance + VARIABLE_SIGMAS * onboard.variation(near).astype(float))
    # The compiled function knows the neighbours among the stars only.
    single = ~sky.crowded(star_index)
    return star_index[single], centroid[single]


@compiled
def zero_point(magnitude: np.ndarray, star_index: np.ndarray, detected: np.ndarray,
               flux: np.ndarray) -> float:
    """
    Return the median magnitude of 1 DN by stars (N,) of a catalogue and their flux (N,) in DN.

    Only those detected (N,) bool count; NaN without any, or where one has no positive flux.
    """
    measured, count = np.empty(len(flux)), 0
    for i in range(len(flux)):
        if detected[i]:
            if not flux[i] > 0:
                return np.nan
            insert_sorted(measured, count, magnitude[star_index[i]] + 2.5 * math.log10(flux[i]))
            count += 1
    middle = count // 2
    if not count:
        return np.nan
    return (measured[middle] if count % 2 else (measured[middle - 1] + measured[middle]) / 2)


@compiled
def _match(near: np.ndarray, sensor: np.ndarray, uv: np.ndarray, magnitude: np.ndarray,
           crowded: np.ndarray, centroid_uv: np.ndarray, flux: np.ndarray, sigma_px: np.ndarray,
           covariance: np.ndarray, lens: Lens, zero_point: float, tolerance: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray]:
    star, centroid = [], []
    of_star, of_centroid = np.zeros(len(near), np.int64), np.zeros(len(flux), np.int64)
    jacobian = np.empty((2, 3))
    measured_magnitude = np.empty(len(flux))
    for j in range(len(flux)):
        measured_magnitude[j] = zero_point - 2.5 * math.log10(flux[j]) if flux[j] > 0 else np.nan
    for i in range(len(near)):
        for j in range(len(flux)):
            du, dv = centroid_uv[j, 0] - uv[i, 0], centroid_uv[j, 1] - uv[i, 1]
            square = du * du + dv * dv
            # Written so that NaN never agrees.
            if not (square < MAX_DISTANCE_PX ** 2
                    and abs(measured_magnitude[j] - magnitude[near[i]]) <= tolerance[i]):
                continue
            a, b = plane_point(lens.equidistant, sensor[i, 0], sensor[i, 1], sensor[i, 2])
            image_flow(lens, a, b, jacobian)
            predicted_variance = 0.0
            for axis in range(2):
                for k in range(3):
                    for m in range(3):
                        predicted_variance += (
                            jacobian[axis, k] * covariance[k, m] * jacobian[axis, m])
            if square <= GATE_SIGMA ** 2 * (sigma_px[j] ** 2 + predicted_variance / 2):
                star.append(i)
                centroid.append(j)
                of_star[i] += 1
                of_centroid[j] += 1
    alone = np.empty((2, len(star)), np.int64)
    count = 0
    for i, j in zip(star, centroid):
        if of_star[i] == 1 and of_centroid[j] == 1 and not crowded[near[i]]:
            alone[0, count], alone[1, count] = near[i], j
            count += 1
    return alone[0, :count], alone[1, :count]
