# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Frames of a narrow field identified by extended grids, by the grid alone and by triangles.

Qian, Sun, Cai, Huang.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from startracker_ros.core.attitude.estimate import cramer_rao
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.maths.rotation import (
    angle_between, multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.core.papers.extended_grid import (
    AttitudePrediction, AttitudePropagator, ExtendedGridIdentifier, ExtendedGridOptions,
    PredictedField)
from startracker_ros.tools.figures.correctness import right_and_wrong
from startracker_ros.tools.figures.timing import cpu_timed

EPOCH_YEAR = 2026.5
# The 1024 px of the paper span the extended field: the sensor itself has half of them.
IMAGE_PX = 512
CATALOG_LIMIT = 8.0
CATALOG_SIGMA_PX = 0.1
CATALOG_SIGMA_MAG = 0.1
DRIFT_DEG_H = 1.0
RANDOM_DEG_H = 0.5
GYRO_PERIOD_S = 1.0
RATE_DEG_S = 0.06
# The attitude before has the covariance of the fewest stars of a success, at these positions.
_EARLIER_STARS_PX = (IMAGE_PX - 1) * np.array([[0.25, 0.5], [0.75, 0.5]])
# The gate of the sides of a triangle, the same as that of a star.
_TRIANGLE_SIGMAS = 3.5
_DEG_H = np.radians(1 / 3600)

METHODS = 'verified', 'grid', 'grid, one limit', 'triangles', 'plain grid'
"""
Ours; the paper's; the same with the catalogue to one limiting magnitude; its two peers.

The peers are the triangles of the extended-image method, and grids of the observed image alone.
"""

BIN_DEG = 0.1
_BINS = np.arange(0, 60) * BIN_DEG


@dataclass(frozen=True)
class Condition:
    """The noise of the frames of one figure; perfect leaves out every other noise too."""

    position_px: float = 0.35
    magnitude_sigma: float = 0.2
    period_s: float = 1.0
    magnitude_limit: float = 7.5
    field_deg: float = 4.0
    perfect: bool = False


@dataclass(frozen=True)
class Tally:
    """
    Results of F frames.

    stars (F,) counts the stars in the image; right and wrong (F, M) those that each of METHODS
    identified correctly and falsely. neighbours, extended_right and plain_right (F,) count
    stars whose nearest neighbour is in the catalogue, and those with the same one in the
    combined and in the plain image. pairs (F, B) counts pairs of stars by their separation, in
    bins of BIN_DEG. time_ms (F, 3) is the process CPU time of identify(), of the patterns
    alone, and of the Pyramid without a prediction, NaN but under the condition by default.
    """

    stars: np.ndarray
    right: np.ndarray
    wrong: np.ndarray
    neighbours: np.ndarray
    extended_right: np.ndarray
    plain_right: np.ndarray
    pairs: np.ndarray
    time_ms: np.ndarray

    def solved(self, method: str) -> np.ndarray:
        """Return the frames (F,) with two stars identified or more, and none falsely."""
        column = METHODS.index(method)
        return (self.right[:, column] >= 2) & (self.wrong[:, column] == 0)

    def percent(self, method: str) -> float:
        """Return the share of the frames that a method solves, in %."""
        return 100 * float(np.mean(self.solved(method)))

    def two_percent(self, method: str) -> float:
        """Return the share of the frames with two stars identified or more, in %."""
        return 100 * float(np.mean(self.right[:, METHODS.index(method)] >= 2))


@cache
def camera(field_deg: float) -> Camera:
    """Return the camera of a field: 28.1 arcsec a pixel for that of the paper."""
    return Camera.from_fov(IMAGE_PX, IMAGE_PX, field_deg)


@cache
def _sky(field_deg: float) -> OnboardCatalog:
    return onboard_catalog(load_catalog(), camera(field_deg), EPOCH_YEAR)


@cache
def identifiers(field_deg: float, perfect: bool
                ) -> tuple[ExtendedGridIdentifier, PyramidIdentifier]:
    """
    Return an identifier whose catalogue has the paper's noise, and the Pyramid.

    The noise is the same in every process. Cell and buffer radius grow with the field.
    """
    lens = camera(field_deg)
    scale = field_deg / Condition().field_deg
    options = IdentificationOptions(method='extended_grid', magnitude_limit=CATALOG_LIMIT)
    identifier = ExtendedGridIdentifier(lens, EPOCH_YEAR, options, grid=ExtendedGridOptions(
        grid_cell_deg=0.2 * scale, grid_buffer_deg=0.3 * scale))
    if not perfect:
        rng = np.random.default_rng(0)
        onboard = identifier.onboard
        # Noise along the line of sight does nothing.
        direction = onboard.direction + rng.normal(
            0, CATALOG_SIGMA_PX * lens.pixel_rad, onboard.direction.shape)
        magnitude = onboard.magnitude + rng.normal(0, CATALOG_SIGMA_MAG, len(onboard))
        order = np.argsort(magnitude)
        identifier.onboard = OnboardCatalog(
            onboard.hip[order],
            (direction / np.linalg.norm(direction, axis=1, keepdims=True))[order],
            magnitude[order], onboard.crowded[order], onboard.blended[order])
    return identifier, PyramidIdentifier(lens, EPOCH_YEAR, options, load_catalog())


def predicted(q: np.ndarray, condition: Condition, rng: np.random.Generator
              ) -> tuple[np.ndarray, AttitudePrediction]:
    """Return the true attitude a period after q (4,), and its prediction by the gyro."""
    axis = rng.standard_normal(3)
    rate = np.radians(RATE_DEG_S) * axis / np.linalg.norm(axis)
    truth = multiply(q, quaternion_from_rotation_vector(rate * condition.period_s))
    if condition.perfect:
        return truth, AttitudePrediction(truth, np.zeros((3, 3)))
    sigma_px = np.hypot(condition.position_px, CATALOG_SIGMA_PX)
    lens = camera(condition.field_deg)
    covariance = cramer_rao(lens.unproject(_EARLIER_STARS_PX),
                            np.full(2, sigma_px * lens.pixel_rad))
    error = rng.multivariate_normal(np.zeros(3), covariance)
    propagator = AttitudePropagator(GyroErrorOptions(
        gyro_drift_deg_h=DRIFT_DEG_H, gyro_rate_change_deg_s2=0.0,
        # From deg/h of one measurement to the angular random walk in deg/sqrt(h).
        gyro_noise_deg_sqrt_h=RANDOM_DEG_H * np.sqrt(GYRO_PERIOD_S / 3600)))
    propagator.start(0, multiply(q, quaternion_from_rotation_vector(error)), covariance)
    for k, error in enumerate(_rate_errors(condition.period_s, rng)):
        propagator.add_rate(round((k + 1) * GYRO_PERIOD_S * 1e9), rate + error)
    prediction = propagator.predict(round(condition.period_s * 1e9))
    assert prediction is not None, 'it has rates up to the end of the period'
    return truth, prediction


def _rate_errors(period_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return the errors (K, 3) in rad/s of the rates that the gyro measures in a period."""
    drift = DRIFT_DEG_H * _DEG_H * rng.choice([-1, 1], 3)
    count = round(period_s / GYRO_PERIOD_S)
    return drift + rng.normal(0, RANDOM_DEG_H * _DEG_H, (count, 3))


def gyro_drift_px(condition: Condition, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Return how far (draws,) the errors of the gyro move the centre of the image in a period."""
    angle = np.array([_rate_errors(condition.period_s, rng).sum(0) for _ in range(draws)])
    return np.hypot(angle[:, 0], angle[:, 1]) * GYRO_PERIOD_S / camera(
        condition.field_deg).pixel_rad


def frames(condition: Condition, trials: int, seed: int) -> Tally:
    """Return the results of frames; a seed has the same directions under every condition."""
    identifier, pyramid = identifiers(condition.field_deg, condition.perfect)
    rows = [_frame(identifier, pyramid, condition, np.random.default_rng((seed, trial)))
            for trial in range(trials)]
    return Tally(*(np.array(column) for column in zip(*rows)))


def _frame(identifier: ExtendedGridIdentifier, pyramid: PyramidIdentifier, condition: Condition,
           rng: np.random.Generator) -> tuple:
    """Return one row of the tally."""
    q, prior = predicted(random_attitude(rng), condition, rng)
    centroids, hip = star_list(
        _sky(condition.field_deg), camera(condition.field_deg), q, condition.position_px, rng,
        magnitude_sigma=condition.magnitude_sigma)
    seen = centroids.flux >= 1e6 * 10 ** (-0.4 * condition.magnitude_limit)
    centroids, hip = centroids.select(seen), hip[seen]
    # The times of one condition are shown.
    timed = cpu_timed if condition == Condition() else _untimed
    cpu_s, result = timed(identifier.identify, centroids, prior)
    pyramid_s = np.nan
    if condition == Condition():
        pyramid_s, _ = cpu_timed(pyramid.identify, centroids)

    field = identifier.field_stars(centroids)
    hip_seen = hip[field.index]
    observed = field.direction[:, :2] / field.direction[:, 2:]
    predict_s, sky = timed(identifier.predicted_field, prior.quaternion)
    hip_known = identifier.onboard.hip[sky.star]
    image = sky.brightest(len(observed))
    beyond = image.tangent[~image.inside]
    grid_s, grid = timed(identifier.recognise, observed, sky)
    sigma = np.hypot(condition.position_px, CATALOG_SIGMA_PX) * identifier.camera.pixel_rad
    rows = {
        'grid': grid,
        'grid, one limit': identifier.match(observed, beyond, [image]),
        'triangles': triangle_votes(observed, image, identifier.buffer_rad, sigma),
        'plain grid': identifier.match(observed, beyond[:0], sky.about_limit(len(observed)))}
    counts = [right_and_wrong(result.hip, hip), *(
        right_and_wrong(np.where(rows[method] >= 0, hip_known[rows[method]], 0), hip_seen)
        for method in METHODS[1:])]
    right, wrong = zip(*counts)
    return (len(centroids), right, wrong, *_neighbours(identifier, observed, hip_seen, image,
                                                       hip_known),
            _separations(field.direction),
            [1e3 * time_s for time_s in (cpu_s, predict_s + grid_s, pyramid_s)])


def _untimed(function: Callable, *arguments: object) -> tuple[float, Any]:
    """Return NaN for the time, and what a function returns."""
    return np.nan, function(*arguments)


def _separations(direction: np.ndarray) -> np.ndarray:
    """Return the number of pairs of stars (N, 3) in each bin of separation."""
    first, second = np.triu_indices(len(direction), 1)
    return np.histogram(np.degrees(angle_between(direction[first], direction[second])), _BINS)[0]


def _neighbours(identifier: ExtendedGridIdentifier, observed: np.ndarray, hip: np.ndarray,
                image: PredictedField, hip_known: np.ndarray) -> tuple[int, int, int]:
    """Return the counts neighbours, extended_right and plain_right of a frame."""
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
    three sides have to agree within their known noise, with one star only. Its fourth step,
    where fewer than two stars are found so: the same with the stars beyond the edge, whose
    triangles identify the observed stars that they contain.
    """
    # All of the extended field is the extension, more than the stars that left the image.
    beyond = np.flatnonzero(~image.inside)
    combined = np.concatenate([observed, image.tangent[beyond]])
    tolerance = _TRIANGLE_SIGMAS * np.sqrt(2) * sigma_rad
    seen, _ = _triangles(combined, np.arange(len(observed)), buffer_rad)
    known = np.flatnonzero(image.inside)
    votes = _only_agreeing(seen, _triangles(image.tangent, known, buffer_rad)[0], known, tolerance)
    if np.count_nonzero(votes >= 0) >= 2:
        return votes
    seen, members = _triangles(combined, np.arange(len(observed), len(combined)), buffer_rad)
    there, stars = _triangles(image.tangent, beyond, buffer_rad)
    # A star beyond the edge is known: there is one triangle to compare with.
    agreed = (np.abs(seen - there) <= tolerance).all(1)
    for corner, star in zip(members[agreed].ravel(), stars[agreed].ravel()):
        if corner < len(observed) and image.inside[star]:
            votes[corner] = star
    return votes


def _only_agreeing(seen: np.ndarray, there: np.ndarray, known: np.ndarray, tolerance: float
                   ) -> np.ndarray:
    """Return the star of known (M,) whose sides (M, 3) alone agree with those seen (N, 3), -1."""
    if not len(known):
        return np.full(len(seen), -1)
    fits = (np.abs(seen[:, None] - there) <= tolerance).all(2)
    return np.where(fits.sum(1) == 1, known[fits.argmax(1)], -1)


def _triangles(position: np.ndarray, reference: np.ndarray, buffer_rad: float
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return sides (K, 3) of reference stars (K,), NaN without two neighbours (K, 2)."""
    if len(position) < 3:
        return np.full((len(reference), 3), np.nan), np.zeros((len(reference), 2), int)
    away = position - position[reference][:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    distance = np.where(distance > buffer_rad, distance, np.inf)
    near = np.argsort(distance, axis=1)[:, :2]
    sides = np.take_along_axis(distance, near, 1)
    opposite = np.linalg.norm(position[near[:, 0]] - position[near[:, 1]], axis=1)
    complete = np.isfinite(sides).all(1)[:, None]
    return np.where(complete, np.column_stack([sides, opposite]), np.nan), near
