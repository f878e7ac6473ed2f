# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A predicted attitude, corrected by all centroids of a frame at once: compiled."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState, with_attitude
from startracker_ros.core.camera.lens import Lens, project, shows
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion, sensor_directions
from startracker_ros.core.track.association import associate, DetectionModel, most_probable
from startracker_ros.core.track.innovation import combined_innovation, normal_equations
from startracker_ros.core.track.motion_models import image_flows
from startracker_ros.core.track.rotation_fit import OUTLIER_SIGMA


class Correction(NamedTuple):
    """
    A predicted attitude, corrected by a frame of M centroids.

    inside (N,) masks the stars that are predicted in the image, K of them. Of each of these:
    predicted (K, 2) px; probability (K, M + 1) as of associate(); inlier (K,), whether it was
    detected and corrects the attitude; normalised (K,) is the distance of its most probable
    centroid from its position by the corrected state in sigma, distance (K,) the same in px,
    along a streak as many sigma of the narrow direction, both infinity where it was missed; best
    (K,) is that centroid. unassociated (M,) masks the centroids in no gate. agreed is False when
    there are too few inliers. innovation (3,) is the measured turn, whitened by its covariance:
    its square is the normalised innovation squared, of 3 degrees of freedom. The stars measure the
    turn (3,) from the predicted attitude, of covariance turn_covariance (3, 3): information and
    vector are (3, 3) and (3,). With a rolling shutter they measure the rate as well, (6, 6) and
    (6,), and turn contains the error of the corrected rate; an error e of the acceleration that
    brought the rows to one time changes what they measure by by_acceleration (6, 3) e, which is
    (3, 3) and zero without a rolling shutter. stars counts the
    usable stars in the image; of the inliers residual_px is the rms of distance, chi2 the sum of
    normalised squared, and typical the median of normalised, NaN where there are too few.
    """

    agreed: bool
    inside: np.ndarray
    predicted: np.ndarray
    probability: np.ndarray
    unassociated: np.ndarray
    state: AttitudeState
    information: np.ndarray
    vector: np.ndarray
    by_acceleration: np.ndarray
    turn: np.ndarray
    turn_covariance: np.ndarray
    inlier: np.ndarray
    distance: np.ndarray
    normalised: np.ndarray
    best: np.ndarray
    innovation: np.ndarray
    stars: int
    residual_px: float
    chi2: float
    typical: float
    precise: float


@compiled
def correct(lens: Lens, icrf: np.ndarray, usable: np.ndarray, min_stars: int,
            predicted: AttitudeState, uv: np.ndarray, error: np.ndarray, delay_s: np.ndarray,
            detection: DetectionModel) -> Correction:
    """
    Associate centroids with predicted stars and correct the attitude by the inliers.

    icrf (N, 3) are the directions of the stars, usable (N,) those that may correct it;
    centroids uv (M, 2) px of covariance error (M, 2, 2). One outlier is removed at a time, the
    worst: it biases the attitude and with it the residuals of all others.

    Of a rolling shutter uv are where the predicted rate has the stars at the time of the frame,
    delay_s (M,) after which they are exposed. With an error e of that rate they are J delay_s e
    away, J the image jacobian: each star measures attitude and rate by [J, delay_s J].
    """
    sensor = sensor_directions(matrix_from_quaternion(predicted.quaternion), icrf)
    inside = _in_image(lens, project(lens, sensor))
    icrf, sensor = icrf[inside], sensor[inside]
    predicted_uv, H = project(lens, sensor), image_flows(lens, sensor)
    P = np.ascontiguousarray(predicted.covariance[:3, :3])
    rolling = delay_s.any()
    moved = P
    if rolling:
        moved = P + np.max(delay_s ** 2) * predicted.covariance[3:6, 3:6]
    beta, unassociated = associate(
        predicted_uv, _pixel_covariance(H, moved), uv, error, detection)
    z, R = combined_innovation(predicted_uv, uv, error, beta)
    usable = usable[inside]
    detected, best = beta[:, 0] <= 0.5, most_probable(beta)
    # A star that was missed rather than not would pull towards the centroid of another one.
    weight = (1 - beta[:, 0]) * usable * detected
    distance, normalised = np.full(len(icrf), np.inf), np.full(len(icrf), np.inf)
    delay = np.zeros(len(icrf))
    if rolling:
        delay[detected] = delay_s[best[detected]]
    while True:
        information, vector = normal_equations(H, z, R, weight)
        if rolling:
            information, vector = _with_rate(information, vector, H, z, R, weight, delay)
        quaternion, rate, drift, covariance = with_attitude(
            predicted.quaternion, predicted.rate, predicted.drift, predicted.covariance,
            information, vector)
        state = AttitudeState(predicted.stamp_ns, quaternion, rate, drift, covariance)
        inlier = (weight > 0) & detected
        if np.sum(inlier) < min_stars:
            return Correction(False, inside, predicted_uv, beta, unassociated, state,
                              information, vector, np.zeros((len(vector), 3)), np.zeros(3),
                              np.zeros((3, 3)), inlier, distance, normalised, best,
                              np.zeros(3), np.sum(usable), np.nan, np.nan, np.nan, np.nan)
        corrected = project(lens, sensor_directions(matrix_from_quaternion(quaternion), icrf))
        if rolling:
            for star in range(len(corrected)):
                corrected[star] += delay[star] * (H[star] @ (rate - predicted.rate))
        _fill_residuals(corrected, uv, error, detected, best, distance, normalised)
        worst = np.argmax(np.where(inlier, normalised, 0.0))
        if normalised[worst] <= OUTLIER_SIGMA:
            break
        weight[worst] = 0.0
    turn_covariance = np.ascontiguousarray(
        np.linalg.inv(np.ascontiguousarray(information[:3, :3])))
    turn = turn_covariance @ vector[:3]
    S = P + turn_covariance
    if rolling:
        # By an error e of the rate the turn is off by lever e.
        lever = turn_covariance @ np.ascontiguousarray(information[:3, 3:])
        cross = lever @ np.ascontiguousarray(predicted.covariance[3:6, :3])
        S += cross + cross.T + _turned(lever, predicted.covariance)
    innovation = np.linalg.solve(np.linalg.cholesky(S), turn)
    by_acceleration = np.zeros((len(vector), 3))
    if rolling:
        # An error e moves a star by J delay_s^2 / 2 e.
        for power in range(2):
            by_acceleration[3 * power:3 * power + 3] = normal_equations(
                H, z, R, weight * delay ** (2 + power) / 2)[0]
        by_acceleration = np.ascontiguousarray(np.linalg.solve(information, by_acceleration))
        turn = turn - lever @ (rate - predicted.rate)
        turn_covariance = turn_covariance + _turned(lever, covariance)
    return Correction(True, inside, predicted_uv, beta, unassociated, state, information, vector,
                      by_acceleration, turn, turn_covariance, inlier, distance, normalised, best,
                      innovation, np.sum(usable),
                      np.sqrt(np.mean(distance[inlier] ** 2)), np.sum(normalised[inlier] ** 2),
                      np.median(normalised[inlier]), _precise(error[best[inlier]],
                                                              normalised[inlier]))


@compiled
def _precise(error: np.ndarray, normalised: np.ndarray) -> float:
    """Return the median of normalised (K,) of the half with the least errors (K, 2, 2)."""
    area2 = error[:, 0, 0] * error[:, 1, 1] - error[:, 0, 1] ** 2
    half = len(area2) // 2
    # They have the weight in the fit: of 2 K residuals nearly all of its three angles.
    left = max(1 - 1.5 / max(half, 1), 0.1)
    return np.median(normalised[np.argsort(area2)[:half]]) / np.sqrt(left)


@compiled
def _fill_residuals(corrected: np.ndarray, uv: np.ndarray, error: np.ndarray,
                    detected: np.ndarray, best: np.ndarray, distance: np.ndarray,
                    normalised: np.ndarray) -> None:
    """Fill distance (K,) px and normalised (K,), in sigma, of the detected stars' centroids."""
    for star in range(len(corrected)):
        if not detected[star]:
            continue
        du = uv[best[star], 0] - corrected[star, 0]
        dv = uv[best[star], 1] - corrected[star, 1]
        if np.isnan(du + dv):
            # The corrected direction is behind the camera.
            distance[star] = normalised[star] = np.inf
            continue
        R = error[best[star]]
        normalised[star] = np.sqrt((R[1, 1] * du * du - 2 * R[0, 1] * du * dv + R[0, 0] * dv * dv)
                                   / (R[0, 0] * R[1, 1] - R[0, 1] * R[0, 1]))
        half = (R[0, 0] - R[1, 1]) / 2
        across = (R[0, 0] + R[1, 1]) / 2 - np.sqrt(half * half + R[0, 1] * R[0, 1])
        distance[star] = normalised[star] * np.sqrt(across)


@compiled
def _with_rate(information: np.ndarray, vector: np.ndarray, H: np.ndarray, z: np.ndarray,
               R: np.ndarray, weight: np.ndarray, delay_s: np.ndarray
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return information (6, 6) and vector (6,) of [H, delay_s H], by those of H."""
    both, both_vector = np.empty((6, 6)), np.empty(6)
    cross, rate_vector = normal_equations(H, z, R, weight * delay_s)
    own, _ = normal_equations(H, z, R, weight * delay_s ** 2)
    both[:3, :3], both[:3, 3:], both[3:, :3], both[3:, 3:] = information, cross, cross.T, own
    both_vector[:3], both_vector[3:] = vector, rate_vector
    return both, both_vector


@compiled
def _turned(lever: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of lever (3, 3) times the rate of a state (9, 9)."""
    return lever @ np.ascontiguousarray(covariance[3:6, 3:6]) @ lever.T


@compiled
def on_image(lens: Lens, icrf: np.ndarray, state: AttitudeState
             ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return state (N, 4) and covariance (N, 4, 4), as in motion_models, of directions (N, 3).

    Position and velocity are the image jacobian (2, 3) times attitude and rate; so are their
    errors.
    """
    sensor = sensor_directions(matrix_from_quaternion(state.quaternion), icrf)
    uv, jacobian = project(lens, sensor), image_flows(lens, sensor)
    track, covariance = np.zeros((len(icrf), 4)), np.zeros((len(icrf), 4, 4))
    half = np.empty((4, 6))
    for star in range(len(icrf)):
        flow = jacobian[star]
        for axis in range(2):
            track[star, 2 * axis] = uv[star, axis]
            for k in range(3):
                track[star, 2 * axis + 1] += flow[axis, k] * state.rate[k]
            for k in range(6):
                half[2 * axis, k] = half[2 * axis + 1, k] = 0.0
                for j in range(3):
                    half[2 * axis, k] += flow[axis, j] * state.covariance[j, k]
                    half[2 * axis + 1, k] += flow[axis, j] * state.covariance[3 + j, k]
        for row in range(4):
            for axis in range(2):
                for k in range(3):
                    covariance[star, row, 2 * axis] += half[row, k] * flow[axis, k]
                    covariance[star, row, 2 * axis + 1] += half[row, 3 + k] * flow[axis, k]
    return track, covariance


@compiled
def _in_image(lens: Lens, uv: np.ndarray) -> np.ndarray:
    """Return where pixels (N, 2) lie in the image; NaN does not."""
    inside = np.empty(len(uv), np.bool_)
    for i in range(len(uv)):
        inside[i] = shows(lens, uv[i, 0], uv[i, 1])
    return inside


@compiled
def _pixel_covariance(H: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return H P H^T (N, 2, 2) px^2 of an attitude covariance P (3, 3) rad^2."""
    covariance = np.zeros((len(H), 2, 2))
    for star in range(len(H)):
        for row in range(2):
            for column in range(2):
                for i in range(3):
                    for j in range(3):
                        covariance[star, row, column] += (
                            H[star, row, i] * P[i, j] * H[star, column, j])
    return covariance
