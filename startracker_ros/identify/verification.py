"""Whether a candidate attitude is right: all stars of the field, and what chance would do.

The statistical model. A candidate comes from three stars. Were it wrong, each of the
other n - 3 image stars would still fall within the matching radius of some catalogue
star with probability p = density x radius area, independently, so m matches or more
have the probability of a binomial tail. Stars of a cluster are not independent: the
Pleiades, shifted or turned, put several stars on others at once. So stars of one small
cell of the image count as one. A wrong candidate lies somewhere on the sky, so the field
that it predicts must by chance be as empty as this one: the share of random fields with
no more catalogue stars than the candidate has. The product, times the
number of candidates that were tested, is the false-alarm probability.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from startracker_ros.attitude.davenport import davenport
from startracker_ros.attitude.estimate import AttitudeError, AttitudeEstimate, estimate_attitude
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.rotation import matrix_from_quaternion


@dataclass(frozen=True)
class Match:
    """A verified or refuted candidate.

    star (N,) is the index into the places for each image star, -1 for none; residual_px
    (N,) the distance to it, NaN for none; attitude None when too few stars match; chance
    the false-alarm probability.
    """

    star: np.ndarray
    residual_px: np.ndarray
    attitude: AttitudeEstimate | None
    focal_ratio: float
    chance: float

    @classmethod
    def refuted(cls, count: int) -> 'Match':
        """Return the match of none of count image stars."""
        return cls(np.full(count, -1), np.full(count, np.nan), None, 1.0, 1.0)

    @property
    def matched(self) -> int:
        """Number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class Verifier:
    """Holds the sky and the camera against which candidates are judged."""

    # Random directions at which the emptiness of the sky is sampled.
    _SAMPLES = 2000
    # Image stars that are looked up for each candidate, and candidates that are then judged.
    _SUPPORTERS = 8
    _JUDGED = 5
    # Cells along one side of a square image: 3/4 of a degree in a field of 12.
    _CELLS = 16

    def __init__(self, camera: Camera, places: StarPlaces, tolerance_sigmas: float,
                 scale_error: float) -> None:
        self._camera = camera
        self._places = places
        self._tolerance_sigmas = tolerance_sigmas
        self._scale_error = scale_error
        # A field of view wider than it says lets in stars from a little beyond its corners.
        self._field_radius = 1.05 * camera.corner_angle_rad
        self._focal_px = np.array([camera.fx, camera.fy])
        self._centre = np.array([camera.cx, camera.cy])
        self._area = camera.width * camera.height * camera.pixel_rad ** 2
        self._counts = self._field_counts()

    def _field_counts(self) -> np.ndarray:
        """Return the sorted numbers of stars in discs of the size of the image."""
        radius = np.arccos(1 - min(self._area / (2 * np.pi), 2.0))
        vectors = np.random.default_rng(0).standard_normal((self._SAMPLES, 3))
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        return np.sort(self._places.count_within(vectors, radius))

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """Return the candidates (K,) that further image stars support, the best first.

        image (N, 3) are the image stars, base (3,) those of the triangle, stars (M, 3) the
        catalogue stars it may be. Written as a sum of the corners of the triangle a star
        needs no attitude to be predicted, and a wrong focal length cancels.
        """
        if not len(stars):
            return np.empty(0, int)
        others = np.setdiff1d(np.arange(len(image)), base)
        weights = np.linalg.solve(image[base].T, image[others].T).T
        sigma = np.hypot(sigma_rad[others], np.linalg.norm(weights * sigma_rad[base], axis=1))
        steady = np.argsort(sigma)[:self._SUPPORTERS]
        expected = weights[steady] @ self._places.direction[stars]
        expected /= np.linalg.norm(expected, axis=2, keepdims=True)
        gap = self._places.distance_to_nearest(expected)
        count = (gap <= self._tolerance_sigmas * sigma[steady]).sum(1)
        order = np.argsort(-count, kind='stable')[:self._JUDGED]
        # Far less support than the best one has is chance.
        return order[count[order] > count[order[0]] // 3]

    def judge(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
              star: np.ndarray, tested: int) -> Match:
        """Return how well the field fits when image stars base (3,) are the stars star (3,).

        image (N, 3) and sigma_rad (N,) are those of all image stars; tested is how many
        candidates there were so far.
        """
        count = len(image)
        observed = image[:, :2] / image[:, 2:]
        radius = self._tolerance_sigmas * float(np.median(sigma_rad))
        matched = np.full(count, -1)
        matched[base] = star
        ratio = 1.0
        # The first radius allows for the attitude that three close stars extrapolate.
        for factor in (3.0, 1.0, 1.0):
            before, known = matched, matched >= 0
            seen, true = observed[known], self._places.direction[matched[known]]
            weight = 1 / sigma_rad[known] ** 2
            quaternion, _ = davenport(_directions(seen / ratio), true, weight / weight.sum())
            matrix = matrix_from_quaternion(quaternion)
            if self._scale_error:
                ratio = _scale(seen, _tangent(true @ matrix))
            if len(seen) == 3:
                # Three close stars alone may know the scale less well than it was known before.
                ratio = float(np.clip(ratio, 1 - self._scale_error, 1 + self._scale_error))
            near = self._places.within(matrix[:, 2], self._field_radius)
            place = _tangent(self._places.direction[near] @ matrix)
            nearest, distance = _pair_up(observed / ratio, place, factor * radius)
            matched = np.where(nearest >= 0, near[nearest], -1)
            if np.count_nonzero(nearest >= 0) < 4:
                return Match.refuted(count)
            if np.array_equal(matched, before):
                break
        known = matched >= 0
        spread = observed[known] - observed[known].mean(0)
        if abs(ratio - 1) > self._scale_error + radius / np.linalg.norm(spread):
            return Match.refuted(count)
        try:
            attitude = estimate_attitude(_directions(observed[known] / ratio),
                                         self._places.direction[matched[known]], sigma_rad[known])
        except AttitudeError:
            return Match.refuted(count)
        pixels = place * ratio * self._focal_px + self._centre
        in_field = np.count_nonzero(self._camera.contains(pixels))
        others = max(self._independent(observed[known]) - 3, 0)
        trials = max(self._independent(observed) - 3, others)
        by_chance = min(1.0, max(in_field, 1) * np.pi * radius ** 2 / self._area)
        tail = float(bdtrc(others - 1, trials, by_chance))
        emptier = np.searchsorted(self._counts, in_field, 'right') / len(self._counts)
        share = max(float(emptier), 1 / len(self._counts))
        return Match(matched, distance / self._camera.pixel_rad, attitude, ratio,
                     min(1.0, tested * tail * share))

    def _independent(self, observed: np.ndarray) -> int:
        """Return how many cells of the image hold points (N, 2)."""
        cell = np.sqrt(self._area) / self._CELLS
        return len(np.unique(np.floor(observed / cell) @ [1.0, 1j]))


def _scale(seen: np.ndarray, expected: np.ndarray) -> float:
    """Return the factor from expected to seen points (N, 2), about their own centres.

    The centres are left to the attitude: were they not, stars on one side of the image
    would hide a wrong scale in a wrong attitude.
    """
    seen, expected = seen - seen.mean(0), expected - expected.mean(0)
    return float(np.sum(seen * expected) / np.sum(expected ** 2))


def _tangent(directions: np.ndarray) -> np.ndarray:
    """Return x / z, y / z (N, 2) of vectors (N, 3) in front of the camera."""
    return directions[:, :2] / directions[:, 2:]


def _directions(tangent: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, 3) of x / z, y / z (N, 2)."""
    vectors = np.column_stack([tangent, np.ones(len(tangent))])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _pair_up(observed: np.ndarray, place: np.ndarray, radius: float
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return for each point (N, 2) the index of the nearest of places (M, 2) and its distance.

    One to one: of several points at one place the nearest has it. -1 and NaN beyond the radius.
    """
    if not len(place):
        return np.full(len(observed), -1), np.full(len(observed), np.nan)
    row = np.arange(len(observed))
    difference = observed[:, None] - place
    square = np.einsum('ijk,ijk->ij', difference, difference)
    nearest = square.argmin(1)
    gap = np.sqrt(square[row, nearest])
    good = (square.argmin(0)[nearest] == row) & (gap <= radius)
    return np.where(good, nearest, -1), np.where(good, gap, np.nan)
