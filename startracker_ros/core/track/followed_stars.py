# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tracks after a frame, by the attitude that it corrected, in one compiled step."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.camera.lens import Lens
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.consistency import Residuals
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion, sensor_directions
from startracker_ros.core.track.bank import associated_columns, Association
from startracker_ros.core.track.correction import on_image
from startracker_ros.core.track.motion_models import image_flows


class Followed(NamedTuple):
    """
    Tracks (K,) after a frame, and its detected stars.

    track (K, 4) and covariance (K, 4, 4) as in motion_models; association the other columns;
    detected (D,) the confirmed tracks with a centroid, residuals theirs.
    """

    track: np.ndarray
    covariance: np.ndarray
    association: Association
    detected: np.ndarray
    residuals: Residuals


class Measured(NamedTuple):
    """Centroids of a frame as in Centroids; variance (M,) and error (M, 2, 2) are px^2."""

    uv: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray
    variance: np.ndarray
    error: np.ndarray


@compiled
def followed(lens: Lens, state: AttitudeState, icrf: np.ndarray, variance: np.ndarray,
             missed: np.ndarray, confirmed: np.ndarray, predicted: np.ndarray,
             probability: np.ndarray, distance: np.ndarray, best: np.ndarray, measured: Measured
             ) -> Followed:
    """
    Return the tracks of stars icrf (K, 3) where the state has them, with their centroids.

    variance, missed and confirmed (K,) are columns of a TrackBank; predicted (K, 2), probability
    (K, M + 1), distance and best (K,) as in a Correction.
    """
    track, covariance = on_image(lens, icrf, state)
    association = associated_columns(
        variance, missed, predicted, probability, measured.uv, measured.variance, measured.flux,
        measured.snr, measured.sigma_px)
    detected, residuals = detected_residuals(
        lens, state, icrf, track, confirmed, distance, best, measured.uv, measured.error)
    return Followed(track, covariance, association, detected, residuals)


@compiled
def detected_residuals(lens: Lens, state: AttitudeState, icrf: np.ndarray, track: np.ndarray,
                       confirmed: np.ndarray, distance: np.ndarray, best: np.ndarray,
                       uv: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, Residuals]:
    """
    Return the detected stars (K,) among N confirmed or new ones, and their residuals.

    icrf (N, 3) are their directions, track (N, 4) their states by the attitude, as in
    motion_models; distance and best (N,) are those of a Correction by centroids uv (M, 2) of
    covariance error (M, 2, 2).
    """
    seen = np.flatnonzero(np.isfinite(distance) & confirmed)
    flow = image_flows(lens, sensor_directions(
        matrix_from_quaternion(state.quaternion), icrf[seen]))
    stars = Residuals(np.empty((len(seen), 2)), np.empty((len(seen), 2)), error[best[seen]], flow,
                      np.zeros((len(seen), 2)))
    for n in range(len(seen)):
        for axis in range(2):
            stars.uv[n, axis] = uv[best[seen[n]], axis]
            stars.residual[n, axis] = stars.uv[n, axis] - track[seen[n], 2 * axis]
            for k in range(3):
                stars.velocity[n, axis] += flow[n, axis, k] * state.rate[k]
    return seen, stars
