"""A predicted attitude, corrected by all centroids of a frame at once: compiled."""

from typing import NamedTuple

import numpy as np
from startracker_ros.attitude.attitude_state import AttitudeState, with_attitude
from startracker_ros.attitude.refinement import matrix_from_quaternion
from startracker_ros.camera.lens import Lens, shows
from startracker_ros.compiled import compiled
from startracker_ros.track.association import associate, Chances, most_probable
from startracker_ros.track.in_view import project
from startracker_ros.track.motion_models import image_flows
from startracker_ros.track.rotation_fit import OUTLIER_SIGMA
from startracker_ros.track.star_votes import expected, turn_asked_for


class Correction(NamedTuple):
    """
    What a frame says about a predicted attitude.

    Of the stars (N,) that were asked for inside (N,) are in the image, K of them: at predicted
    (K, 2) px, with the probabilities (K, M + 1) of the centroids, of which unclaimed (M,) are in
    no gate. agreed says whether enough of them, inlier (K,), leave the state where they do not
    contradict it; distance (K,) px is that of their centroids from their places then, and
    normalised (K,) the same in sigma, infinity for those missed. unforeseen (3,) is the turn that
    they ask for in sigma of what was not known before.
    """

    agreed: bool
    inside: np.ndarray
    predicted: np.ndarray
    probability: np.ndarray
    unclaimed: np.ndarray
    state: AttitudeState
    inlier: np.ndarray
    distance: np.ndarray
    normalised: np.ndarray
    unforeseen: np.ndarray


@compiled
def correct(lens: Lens, icrf: np.ndarray, votes: np.ndarray, min_stars: int,
            predicted: AttitudeState, uv: np.ndarray, variance: np.ndarray, chances: Chances
            ) -> Correction:
    """
    Look for stars where a prediction has them, and correct it by what is there.

    icrf (N, 3) are the directions of the stars, of which those of votes (N,) may say something
    about the attitude; centroids uv (M, 2) px with variance (M,) per axis. The worst outlier
    leaves first: it bends the attitude and makes others look bad.
    """
    sensor = _on_sensor_axes(icrf, predicted.quaternion)
    inside = _in_image(lens, project(lens, sensor))
    icrf, sensor, votes = icrf[inside], sensor[inside], votes[inside]
    place, jacobian = project(lens, sensor), image_flows(lens, sensor)
    prior = np.ascontiguousarray(predicted.covariance[:3, :3])
    probability, unclaimed = associate(place, _spread(jacobian, prior), uv, variance, chances)
    mean, spread = expected(place, uv, variance, probability)
    weight = 1 - probability[:, 0]
    votes = votes & (weight > 0)
    seen = probability[:, 0] <= 0.5
    best = most_probable(probability)
    count = len(icrf)
    distance, normalised = np.full(count, np.inf), np.full(count, np.inf)
    while True:
        information, vector = turn_asked_for(jacobian, mean, spread, weight, votes)
        quaternion, rate, drift, covariance = with_attitude(
            predicted.quaternion, predicted.rate, predicted.drift, predicted.covariance,
            information, vector)
        state = AttitudeState(predicted.stamp_ns, quaternion, rate, drift, covariance)
        inlier = votes & seen
        if np.sum(inlier) < min_stars:
            return Correction(False, inside, place, probability, unclaimed, state, inlier,
                              distance, normalised, np.zeros(3))
        now = project(lens, _on_sensor_axes(icrf, quaternion))
        worst, most = 0, 0.0
        for star in range(count):
            if not seen[star]:
                continue
            du, dv = uv[best[star], 0] - now[star, 0], uv[best[star], 1] - now[star, 1]
            distance[star] = np.sqrt(du * du + dv * dv)
            if np.isnan(distance[star]):
                # Its place has come behind the camera.
                distance[star] = np.inf
            normalised[star] = distance[star] / np.sqrt(variance[best[star]])
            if inlier[star] and normalised[star] > most:
                worst, most = star, normalised[star]
        if most <= OUTLIER_SIGMA:
            break
        votes[worst] = False
    turn = np.linalg.inv(information)
    unforeseen = np.linalg.solve(np.linalg.cholesky(prior + turn), turn @ vector)
    return Correction(True, inside, place, probability, unclaimed, state, inlier, distance,
                      normalised, unforeseen)


@compiled
def on_image(lens: Lens, icrf: np.ndarray, state: AttitudeState
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return state (N, 4) and covariance (N, 4, 4), as in motion_models, of directions (N, 3)."""
    sensor = _on_sensor_axes(icrf, state.quaternion)
    uv, jacobian = project(lens, sensor), image_flows(lens, sensor)
    track, covariance = np.zeros((len(icrf), 4)), np.zeros((len(icrf), 4, 4))
    half = np.empty((4, 6))
    for star in range(len(icrf)):
        flow = jacobian[star]
        for axis in range(2):
            track[star, 2 * axis] = uv[star, axis]
            for k in range(3):
                track[star, 2 * axis + 1] += flow[axis, k] * state.rate[k]
            # Position and velocity alike are the flow times attitude error and rate error.
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
def _on_sensor_axes(icrf: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return directions (N, 3) on the axes of the sensor."""
    matrix = matrix_from_quaternion(quaternion)
    sensor = np.empty((len(icrf), 3))
    for star in range(len(icrf)):
        for axis in range(3):
            sensor[star, axis] = (icrf[star, 0] * matrix[0, axis] + icrf[star, 1] * matrix[1, axis]
                                  + icrf[star, 2] * matrix[2, axis])
    return sensor


@compiled
def _in_image(lens: Lens, uv: np.ndarray) -> np.ndarray:
    """Return where pixels (N, 2) lie in the image; NaN does not."""
    inside = np.empty(len(uv), np.bool_)
    for i in range(len(uv)):
        inside[i] = shows(lens, uv[i, 0], uv[i, 1])
    return inside


@compiled
def _spread(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (N, 2, 2) px^2 of pixels under that of an attitude (3, 3) rad^2."""
    spread = np.zeros((len(jacobian), 2, 2))
    for star in range(len(jacobian)):
        for row in range(2):
            for column in range(2):
                for i in range(3):
                    for j in range(3):
                        spread[star, row, column] += (
                            jacobian[star, row, i] * covariance[i, j] * jacobian[star, column, j])
    return spread
