"""Whether a candidate attitude is right: all stars of the field, and what chance would do.

The statistical model. A candidate comes from three stars. Were it wrong, each of the
other n - 3 image stars would still fall within the matching radius of some catalogue
star with probability p = density x radius area, independently, so m matches or more
have the probability of a binomial tail. A wrong candidate lies somewhere on the sky, so
the field that it predicts must by chance be as empty as this one: the share of random
fields with no more catalogue stars than the candidate has. The product, times the
number of candidates that were tested, is the false-alarm probability.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from startracker_ros.attitude.estimate import AttitudeError, AttitudeEstimate, estimate_attitude
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.rotation import conjugate, matrix_from_quaternion, rotate


@dataclass(frozen=True)
class Match:
    """A verified or refuted candidate.

    star (N,) is the index into the places for each image star, -1 for none; residual_px
    (N,) the distance to it, NaN for none; attitude None when too few stars match.
    """

    star: np.ndarray
    residual_px: np.ndarray
    attitude: AttitudeEstimate | None
    focal_ratio: float
    chance: float

    @property
    def matched(self) -> int:
        """Number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class Verifier:
    """Holds the sky and the camera against which candidates are judged."""

    # Random directions at which the emptiness of the sky is sampled.
    _SAMPLES = 2000

    def __init__(self, camera: Camera, places: StarPlaces, tolerance_sigmas: float,
                 fit_scale: bool) -> None:
        self._camera = camera
        self._places = places
        self._tolerance_sigmas = tolerance_sigmas
        self._fit_scale = fit_scale
        self._counts = self._field_counts()

    def _field_counts(self) -> np.ndarray:
        """Return the sorted numbers of stars in discs of the size of the image."""
        area_sr = self._camera.width * self._camera.height * self._camera.pixel_rad ** 2
        radius = np.arccos(1 - min(area_sr / (2 * np.pi), 2.0))
        vectors = np.random.default_rng(0).standard_normal((self._SAMPLES, 3))
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        return np.sort(self._places.count_within(vectors, radius))

    def judge(self, uv: np.ndarray, sigma_px: np.ndarray, image: np.ndarray, star: np.ndarray,
              focal_ratio: float, tested: int) -> Match:
        """Return how well the field fits when image stars (3,) are the catalogue stars (3,).

        uv (N, 2) and sigma_px (N,) are those of all image stars; tested is how many
        candidates there were so far.
        """
        matched = np.full(len(uv), -1)
        matched[image] = star
        radius_px = self._tolerance_sigmas * float(np.median(sigma_px))
        attitude = None
        # The first radius allows for the attitude that three close stars extrapolate.
        for factor in (3.0, 1.0, 1.0):
            camera = self._camera.with_focal_ratio(focal_ratio)
            known = matched >= 0
            try:
                attitude = estimate_attitude(
                    camera.unproject(uv[known]), self._places.direction[matched[known]],
                    sigma_px[known] * camera.pixel_rad)
            except AttitudeError:
                return Match(np.full(len(uv), -1), np.full(len(uv), np.nan), None, 1.0, 1.0)
            field, place = self._field(camera, attitude.quaternion)
            if self._fit_scale and known.sum() > 3:
                ratio = self._scale(camera, uv[known], attitude.quaternion,
                                    self._places.direction[matched[known]])
                place = (place - [camera.cx, camera.cy]) * ratio + [camera.cx, camera.cy]
                focal_ratio *= ratio
            matched, distance = _pair_up(uv, place, factor * radius_px)
            matched = np.where(matched >= 0, field[matched] if len(field) else -1, -1)
            if np.count_nonzero(matched >= 0) < 4:
                return Match(matched, distance, None, focal_ratio, 1.0)
        others = np.count_nonzero(matched >= 0) - 3
        pixels = self._camera.width * self._camera.height
        chance = min(1.0, max(len(field), 1) / pixels * np.pi * radius_px ** 2)
        tail = float(bdtrc(others - 1, len(uv) - 3, chance)) if others > 0 else 1.0
        emptier = np.searchsorted(self._counts, len(field), 'right') / len(self._counts)
        share = max(emptier, 1 / len(self._counts))
        return Match(matched, distance, attitude, focal_ratio, min(1.0, tested * tail * share))

    def _field(self, camera: Camera, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return indices (M,) and pixels (M, 2) of the catalogue stars in the image."""
        matrix = matrix_from_quaternion(quaternion)
        near = self._places.within(matrix[:, 2], camera.corner_angle_rad)
        pixels = camera.project(self._places.direction[near] @ matrix)
        inside = camera.contains(pixels)
        return near[inside], pixels[inside]

    @staticmethod
    def _scale(camera: Camera, uv: np.ndarray, quaternion: np.ndarray,
               direction: np.ndarray) -> float:
        """Return the factor on the focal length that fits pixels to directions best."""
        centre = [camera.cx, camera.cy]
        expected = camera.project(rotate(conjugate(quaternion), direction)) - centre
        return float(np.sum((uv - centre) * expected) / np.sum(expected ** 2))


def _pair_up(uv: np.ndarray, place: np.ndarray, radius_px: float
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return for each pixel (N, 2) the index of the nearest place and its distance.

    One to one: of several pixels at one place the nearest has it. -1 and NaN beyond the radius.
    """
    if not len(place):
        return np.full(len(uv), -1), np.full(len(uv), np.nan)
    distance = np.linalg.norm(uv[:, None] - place[None], axis=2)
    nearest = distance.argmin(1)
    mutual = distance.argmin(0)[nearest] == np.arange(len(uv))
    gap = distance[np.arange(len(uv)), nearest]
    good = mutual & (gap <= radius_px)
    return np.where(good, nearest, -1), np.where(good, gap, np.nan)
