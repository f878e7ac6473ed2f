"""
Frames of a narrow field identified by extended grids, by the grid alone and by triangles.

Qian, Sun, Cai, Huang.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from startracker_ros.core.attitude.estimate import cramer_rao
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.attitude.propagate import AttitudePrediction, AttitudePropagator
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.extended_grid import ExtendedGridIdentifier, PredictedField
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.tools.figures.timing import cpu_timed

EPOCH_YEAR = 2026.5
CAMERA = Camera.from_fov(1024, 1024, 4.0)
CATALOG_LIMIT = 8.0
CATALOG_SIGMA_PX = 0.1
CATALOG_SIGMA_MAG = 0.1
DRIFT_DEG_H = 1.0
RANDOM_DEG_H = 0.5
GYRO_PERIOD_S = 1.0
RATE_DEG_S = 0.06
# The attitude before has the covariance of the fewest stars of a success, at these positions.
_EARLIER_STARS_PX = np.array([[255.5, 511.5], [767.5, 511.5]])
# The gate of the sides of a triangle, the same as that of a star.
_TRIANGLE_SIGMAS = 3.5
_DEG_H = np.radians(1 / 3600)


@dataclass(frozen=True)
class Condition:
    """The noise of the frames of one figure; perfect leaves out every other noise too."""

    position_px: float = 0.35
    magnitude_sigma: float = 0.2
    period_s: float = 1.0
    magnitude_limit: float = 7.5
    perfect: bool = False


@dataclass(frozen=True)
class Tally:
    """
    Results of F frames.

    stars (F,) counts the stars in the image. solved, grid_solved and triangle_solved (F,) bool
    are frames with at least two identified stars and none misidentified: by the method, by its
    grid alone, by triangles; wrong, grid_wrong and triangle_wrong those with a misidentified
    star. neighbours, extended_right and plain_right (F,) count stars whose nearest neighbour is
    in the catalogue, and those with the same one in the combined and in the plain image.
    time_ms (F,) is the process CPU time of identify().
    """

    stars: np.ndarray
    solved: np.ndarray
    wrong: np.ndarray
    grid_solved: np.ndarray
    grid_wrong: np.ndarray
    triangle_solved: np.ndarray
    triangle_wrong: np.ndarray
    neighbours: np.ndarray
    extended_right: np.ndarray
    plain_right: np.ndarray
    time_ms: np.ndarray

    def percent(self, name: str) -> float:
        """Return the share of the frames in %."""
        return 100 * float(np.mean(getattr(self, name)))


@cache
def _sky() -> OnboardCatalog:
    return onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR)


@cache
def _identifier(perfect: bool) -> ExtendedGridIdentifier:
    """Return an identifier whose catalogue has the paper's noise, the same in every process."""
    identifier = ExtendedGridIdentifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
        method='extended_grid', magnitude_limit=CATALOG_LIMIT))
    if not perfect:
        rng = np.random.default_rng(0)
        onboard = identifier.onboard
        # Noise along the line of sight does nothing.
        direction = onboard.direction + rng.normal(
            0, CATALOG_SIGMA_PX * CAMERA.pixel_rad, onboard.direction.shape)
        magnitude = onboard.magnitude + rng.normal(0, CATALOG_SIGMA_MAG, len(onboard))
        order = np.argsort(magnitude)
        identifier.onboard = OnboardCatalog(
            onboard.hip[order],
            (direction / np.linalg.norm(direction, axis=1, keepdims=True))[order],
            magnitude[order], onboard.crowded[order], onboard.blended[order])
    return identifier


def predicted(q: np.ndarray, condition: Condition, rng: np.random.Generator
              ) -> tuple[np.ndarray, AttitudePrediction]:
    """Return the true attitude a period after q (4,), and its prediction by the gyro."""
    axis = rng.standard_normal(3)
    rate = np.radians(RATE_DEG_S) * axis / np.linalg.norm(axis)
    truth = multiply(q, quaternion_from_rotation_vector(rate * condition.period_s))
    if condition.perfect:
        return truth, AttitudePrediction(truth, np.zeros((3, 3)))
    sigma_px = np.hypot(condition.position_px, CATALOG_SIGMA_PX)
    covariance = cramer_rao(CAMERA.unproject(_EARLIER_STARS_PX),
                            np.full(2, sigma_px * CAMERA.pixel_rad))
    error = rng.multivariate_normal(np.zeros(3), covariance)
    propagator = AttitudePropagator(GyroErrorOptions(
        gyro_drift_deg_h=DRIFT_DEG_H, gyro_rate_change_deg_s2=0.0,
        # From deg/h of one measurement to the angular random walk in deg/sqrt(h).
        gyro_noise_deg_sqrt_h=RANDOM_DEG_H * np.sqrt(GYRO_PERIOD_S / 3600)))
    propagator.start(0, multiply(q, quaternion_from_rotation_vector(error)), covariance)
    drift = DRIFT_DEG_H * _DEG_H * rng.choice([-1, 1], 3)
    for k in range(round(condition.period_s / GYRO_PERIOD_S)):
        propagator.add_rate(round((k + 1) * GYRO_PERIOD_S * 1e9),
                            rate + drift + rng.normal(0, RANDOM_DEG_H * _DEG_H, 3))
    prediction = propagator.predict(round(condition.period_s * 1e9))
    assert prediction is not None, 'it has rates up to the end of the period'
    return truth, prediction


def frames(condition: Condition, trials: int, seed: int) -> Tally:
    """Return the results of frames; a seed has the same directions under every condition."""
    identifier = _identifier(condition.perfect)
    rows = [_frame(identifier, condition, np.random.default_rng((seed, trial)))
            for trial in range(trials)]
    return Tally(*(np.array(column) for column in zip(*rows)))


def _frame(identifier: ExtendedGridIdentifier, condition: Condition,
           rng: np.random.Generator) -> tuple:
    """Return one row of the tally."""
    q, prior = predicted(random_attitude(rng), condition, rng)
    centroids, hip = star_list(_sky(), CAMERA, q, condition.position_px, rng,
                               magnitude_sigma=condition.magnitude_sigma)
    seen = centroids.flux >= 1e6 * 10 ** (-0.4 * condition.magnitude_limit)
    centroids, hip = centroids.select(seen), hip[seen]
    cpu_s, result = cpu_timed(identifier.identify, centroids, prior)

    field = identifier.field_stars(centroids)
    hip_seen = hip[field.index]
    observed = field.direction[:, :2] / field.direction[:, 2:]
    image = identifier.predicted_field(prior.quaternion)
    hip_known = identifier.onboard.hip[image.star]
    votes = identifier.recognise(observed, image)
    sigma = np.hypot(condition.position_px, CATALOG_SIGMA_PX) * CAMERA.pixel_rad
    fits = triangle_votes(observed, image.brightest(len(observed)), identifier.buffer_rad, sigma)
    return (len(centroids), *_solved_and_wrong(result.hip, hip),
            *_solved_and_wrong(np.where(votes >= 0, hip_known[votes], 0), hip_seen),
            *_solved_and_wrong(np.where(fits >= 0, hip_known[fits], 0), hip_seen),
            *_neighbours(identifier, observed, hip_seen, image, hip_known), 1e3 * cpu_s)


def _solved_and_wrong(identified: np.ndarray, hip: np.ndarray) -> tuple[bool, bool]:
    """Return whether two stars or more are identified and none wrongly, and whether any is."""
    wrong = bool(np.any((identified > 0) & (identified != hip)))
    return bool(np.count_nonzero(identified) >= 2 and not wrong), wrong


def _neighbours(identifier: ExtendedGridIdentifier, observed: np.ndarray, hip: np.ndarray,
                image: PredictedField, hip_known: np.ndarray) -> tuple[int, int, int]:
    """Return the counts neighbours, extended_right and plain_right of a frame."""
    image = image.brightest(len(observed))
    hip_known = hip_known[:len(image.star)]
    star, row = np.nonzero(hip[:, None] == hip_known)
    if not len(star):
        return 0, 0, 0
    right = hip_known[identifier.patterns(image.tangent, row)[1]]
    combined = np.concatenate([observed, image.tangent[~image.inside]])
    hip_combined = np.concatenate([hip, hip_known[~image.inside]])
    extended = hip_combined[identifier.patterns(combined, star)[1]]
    plain = hip[identifier.patterns(observed, star)[1]]
    return (len(star), int(np.count_nonzero(extended == right)),
            int(np.count_nonzero(plain == right)))


def triangle_votes(observed: np.ndarray, image: PredictedField, buffer_rad: float,
                   sigma_rad: float) -> np.ndarray:
    """
    Return for each observed position (N, 2) the row of the predicted star, -1 for none.

    The extended-image triangle method: a star and its two nearest neighbours outside the
    buffer radius, in the combined image, against the triangles of the catalogue stars. The
    three sides have to agree within their known noise, with one star only.
    """
    known = np.flatnonzero(image.inside)
    combined = np.concatenate([observed, image.tangent[~image.inside]])
    seen = _triangles(combined, np.arange(len(observed)), buffer_rad)
    there = _triangles(image.tangent, known, buffer_rad)
    tolerance = _TRIANGLE_SIGMAS * np.sqrt(2) * sigma_rad
    fits = (np.abs(seen[:, None] - there) <= tolerance).all(2)
    if not len(known):
        return np.full(len(observed), -1)
    return np.where(fits.sum(1) == 1, known[fits.argmax(1)], -1)


def _triangles(position: np.ndarray, reference: np.ndarray, buffer_rad: float) -> np.ndarray:
    """Return the sides (K, 3) of reference stars (K,); NaN without two neighbours."""
    if len(position) < 3:
        return np.full((len(reference), 3), np.nan)
    away = position - position[reference][:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    distance = np.where(distance > buffer_rad, distance, np.inf)
    near = np.argsort(distance, axis=1)[:, :2]
    sides = np.take_along_axis(distance, near, 1)
    opposite = np.linalg.norm(position[near[:, 0]] - position[near[:, 1]], axis=1)
    complete = np.isfinite(sides).all(1)[:, None]
    return np.where(complete, np.column_stack([sides, opposite]), np.nan)
