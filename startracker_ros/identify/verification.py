"""
Whether a candidate attitude is right: all stars of the field are its judges.

A candidate names a few stars. The attitude and the focal length that fit them pair up the
other stars of the image with the catalogue (pairing.py); what chance would do is held against
that (chance.py); and a lens that is not what it is taken for leaves a trace of its own
(lens_trace.py).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.catalog.sky_grid import count_in_image, count_near, sky_grid, SkyGrid
from startracker_ros.compiled import compiled
from startracker_ros.identify.chance import (
    binomial_tail, cells, combined, distance_chance, order_chance, up_to)
from startracker_ros.identify.lens_trace import wrong_lens
from startracker_ros.identify.pairing import align, fit
from startracker_ros.identify.support import support, support_weights

# Candidates that are judged, those with the most support.
JUDGED = 5
# Random directions at which the emptiness of the sky is sampled.
_SAMPLES = 2000


@dataclass(frozen=True)
class Match:
    """
    A verified or refuted candidate.

    star (N,) is the index into the places for each image star, -1 for none; residual_px
    (N,) the distance to it, NaN for none; attitude None when too few stars match; chance
    the false-alarm probability.
    """

    star: np.ndarray
    residual_px: np.ndarray
    attitude: AttitudeEstimate | None
    focal_ratio: float
    chance: float

    @property
    def matched(self) -> int:
        """Return the number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class Court(NamedTuple):
    """
    What candidates are judged by, for the compiled functions.

    sky, hip (S,) and magnitude (S,) are the catalogue; field holds the borders of the image
    in x / z, y / z (low, high, low, high) and the chord from its axis to the farthest corner;
    area is in rad^2; counts (F,) are the ascending numbers of stars in fields about random
    directions. Where the stars of a
    candidate were themselves found by their brightness, it is no evidence for them.
    """

    sky: SkyGrid
    hip: np.ndarray
    magnitude: np.ndarray
    tolerance_sigmas: float
    scale_error: float
    field: tuple[float, float, float, float, float]
    area: float
    counts: np.ndarray
    bases_by_brightness: bool


class Verifier:
    """Holds the sky and the camera against which candidates are judged."""

    def __init__(self, camera: Camera, places: StarPlaces, tolerance_sigmas: float,
                 scale_error: float, *, bases_by_brightness: bool = False) -> None:
        self._pixel_rad = camera.pixel_rad
        area = camera.width * camera.height * camera.pixel_rad ** 2
        sky = sky_grid(places.direction)
        self.court = Court(
            sky, places.hip, places.magnitude, float(tolerance_sigmas),
            float(scale_error),
            ((-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx,
             (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy,
             # A field of view wider than it says lets in stars from a little beyond.
             2 * np.sin(min(1.1 * camera.corner_angle_rad, np.pi) / 2)),
            area, _field_counts(sky, area), bases_by_brightness)

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """
        Return the candidates (K,) that further image stars support, the best first.

        image (N, 3) are the image stars, base (B,) those that the candidates name, stars (M, B)
        the catalogue stars that they may be.
        """
        weights, reach = support_weights(image, sigma_rad, np.asarray(base),
                                         self.court.tolerance_sigmas)
        count = np.array([support(self.court.sky, weights, reach, candidate[0], candidate[1],
                                  candidate[2], 0) for candidate in stars], int)
        order = np.argsort(-count, kind='stable')[:JUDGED]
        # Far less support than the best one has is chance.
        return order[count[order] > count[order[0]] // 3] if len(order) else order

    def judge(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
              star: np.ndarray, tested: int) -> Match:
        """
        Return how well the field fits when image stars base (B,) are the stars star (B,).

        image (N, 3) and sigma_rad (N,) are those of all image stars; tested is how many
        candidates there were so far.
        """
        seen = tangent(image)
        chance, ratio, star, distance, matrix = judge(
            self.court, seen, sigma_rad, np.asarray(base), np.asarray(star), tested)
        return self.match(chance, ratio, star, distance,
                          fit(self.court.sky, seen, sigma_rad, ratio, star, matrix))

    def match(self, chance: float, ratio: float, star: np.ndarray, distance: np.ndarray,
              fitted: tuple) -> Match:
        """Return what judge() and fit() have found."""
        attitude = None
        if chance < 1:
            quaternion, covariance, residual_rad, chi2 = fitted
            attitude = AttitudeEstimate(quaternion, covariance, len(residual_rad), residual_rad,
                                        chi2)
        return Match(star, distance / self._pixel_rad, attitude, ratio, chance)


def _field_counts(sky: SkyGrid, area: float) -> np.ndarray:
    """Return the sorted numbers of stars in discs of an area in rad^2."""
    # Archimedes: the cap of a sphere has the area of a disc whose radius is its chord.
    chord = min(np.sqrt(area / np.pi), 2.0)
    vectors = np.random.default_rng(0).standard_normal((_SAMPLES, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.sort(count_near(sky, vectors, chord))


@compiled
def same_attitude(star: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two answers agree about two stars, which leaves no room for two attitudes."""
    agreeing = 0
    for i in range(len(star)):
        agreeing += star[i] >= 0 and star[i] == other[i]
    return agreeing >= 2


@compiled
def refuted(count: int) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the verdict of a candidate that names none of count stars."""
    return 1.0, 1.0, np.full(count, -1), np.full(count, np.nan), np.eye(3)


@compiled
def tangent(image: np.ndarray) -> np.ndarray:
    """Return x / z, y / z (N, 2) of vectors (N, 3) in front of the camera."""
    seen = np.empty((len(image), 2))
    for i in range(len(image)):
        seen[i, 0] = image[i, 0] / image[i, 2]
        seen[i, 1] = image[i, 1] / image[i, 2]
    return seen


@compiled
def _middle(values: np.ndarray) -> float:
    """Return the middle one of a few values (N,)."""
    ordered = values.copy()
    for i in range(1, len(ordered)):
        moved = ordered[i]
        j = i
        while j > 0 and ordered[j - 1] > moved:
            ordered[j] = ordered[j - 1]
            j -= 1
        ordered[j] = moved
    return ordered[len(ordered) // 2]


@compiled
def judge(court: Court, seen: np.ndarray, sigma: np.ndarray, base: np.ndarray, star: np.ndarray,
          tested: int) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return chance, focal ratio, star (N,), distance (N,) and matrix (3, 3) of a candidate.

    seen (N, 2) are the image stars in x / z, y / z; distance is measured there; the matrix
    turns sensor vectors to ICRF. A chance of one stands for a candidate that is refuted.
    """
    sky = court.sky
    radius = court.tolerance_sigmas * _middle(sigma)
    holds, ratio, matched, distance, matrix = align(sky, seen, sigma, base, star, radius,
                                                    court.scale_error)
    if not holds:
        return 1.0, ratio, matched, distance, matrix
    low_x, high_x, low_y, high_y, chord = court.field
    in_field = count_in_image(sky, matrix, chord, low_x / ratio, high_x / ratio, low_y / ratio,
                              high_y / ratio)
    every, first = cells(seen, matched, court.area)
    agreeing = 0
    for counted in first:
        agreeing += counted
    # The stars that found the candidate are no evidence for it.
    others = max(agreeing - len(base), 0)
    trials = max(every - len(base), others)
    by_chance = min(1.0, max(in_field, 1) * np.pi * radius ** 2 / court.area)
    share = max(up_to(court.counts, in_field), 1) / len(court.counts)
    if court.bases_by_brightness:
        for i in base:
            first[i] = False
    product = (binomial_tail(others, trials, by_chance) * share * order_chance(matched, first)
               * distance_chance(distance, radius, len(base)))
    chance = min(1.0, max(tested, 1) * combined(product))
    if chance < 1 and wrong_lens(sky, matrix, seen, ratio, radius, matched, by_chance):
        chance = 1.0
    return chance, ratio, matched, distance, matrix
