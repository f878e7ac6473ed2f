"""Whether a candidate attitude is right: all stars of the field, and what chance would do.

The statistical model. A candidate comes from three stars, or b. Were it wrong, each of the
other n - b image stars would still fall within the matching radius of some catalogue
star with probability p = density x radius area, independently, so m matches or more
have the probability of a binomial tail. Stars of a cluster are not independent: the
Pleiades, shifted or turned, put several stars on others at once. So stars of one small
cell of the image count as one. A wrong candidate lies somewhere on the sky, so the field
that it predicts must by chance be as empty as this one: the share of random fields with
no more catalogue stars than the candidate has.

Brightness is evidence of its own. Were the candidate wrong, any order of the catalogue
stars would be as likely as that of their image stars: the chance is the share of all
orders with no more inversions (Kendall 1938). No photometry is asked for but the order.

Both chances together, as Fisher (1925) combines them, times the number of candidates
that were tested, are the false-alarm probability.
"""

from dataclasses import dataclass
from typing import NamedTuple

from numba import njit
import numpy as np

from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.attitude.refinement import quaternion_from_matrix, refine, triad
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.catalog.sky_grid import count_in_image, nearest, sky_grid, SkyGrid

# Image stars that are looked up for each candidate, and candidates that are then judged.
SUPPORTERS = 8
JUDGED = 5
# Random directions at which the emptiness of the sky is sampled.
_SAMPLES = 2000
# Matched stars whose order is looked at.
_ORDERED = 12
# Cells along one side of a square image: 3/4 of a degree in a field of 12.
_CELLS = 16


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

    @property
    def matched(self) -> int:
        """Number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class Court(NamedTuple):
    """What candidates are judged by, for the compiled functions.

    sky, hip (S,) and magnitude (S,) are the catalogue; field holds the borders of the image in x / z, y / z (low, high, low, high) and the
    chord from its axis to the farthest corner; area is in rad^2; counts (S,) are the
    ascending numbers of stars in fields about random directions. Where the stars of a
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
        self.court = Court(
            sky_grid(places.direction), places.hip, places.magnitude, float(tolerance_sigmas),
            float(scale_error),
            ((-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx,
             (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy,
             # A field of view wider than it says lets in stars from a little beyond.
             2 * np.sin(min(1.1 * camera.corner_angle_rad, np.pi) / 2)),
            area, _field_counts(places, area), bases_by_brightness)

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """Return the candidates (K,) that further image stars support, the best first.

        image (N, 3) are the image stars, base (B,) those that the candidates name, stars (M, B)
        the catalogue stars that they may be.
        """
        weights, reach = support_weights(image, sigma_rad, np.asarray(base),
                                         self.court.tolerance_sigmas)
        count = np.array([support(self.court, weights, reach, *candidate[:3])
                          for candidate in stars], int)
        order = np.argsort(-count, kind='stable')[:JUDGED]
        # Far less support than the best one has is chance.
        return order[count[order] > count[order[0]] // 3] if len(order) else order

    def judge(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
              star: np.ndarray, tested: int) -> Match:
        """Return how well the field fits when image stars base (B,) are the stars star (B,).

        image (N, 3) and sigma_rad (N,) are those of all image stars; tested is how many
        candidates there were so far.
        """
        seen = tangent(image)
        chance, ratio, star, distance = judge(self.court, seen, sigma_rad, np.asarray(base),
                                              np.asarray(star), tested)
        return self.match(chance, ratio, star, distance,
                          fit(self.court.sky, seen, sigma_rad, ratio, star))

    def match(self, chance: float, ratio: float, star: np.ndarray, distance: np.ndarray,
              fitted: tuple) -> Match:
        """Return what judge() and fit() have found."""
        attitude = None
        if chance < 1:
            quaternion, covariance, residual_rad, chi2 = fitted
            attitude = AttitudeEstimate(quaternion, covariance, len(residual_rad), residual_rad,
                                        chi2)
        return Match(star, distance / self._pixel_rad, attitude, ratio, chance)


def _field_counts(places: StarPlaces, area: float) -> np.ndarray:
    """Return the sorted numbers of stars in discs of an area in rad^2."""
    radius = np.arccos(1 - min(area / (2 * np.pi), 2.0))
    vectors = np.random.default_rng(0).standard_normal((_SAMPLES, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.sort(places.count_within(vectors, radius))


@njit(cache=True)
def same_attitude(star, other):
    """Return whether two answers agree about two stars, which leaves no room for two attitudes."""
    agreeing = 0
    for i in range(len(star)):
        agreeing += star[i] >= 0 and star[i] == other[i]
    return agreeing >= 2


@njit(cache=True)
def refuted(count):
    """Return the verdict of a candidate that names none of count stars."""
    return 1.0, 1.0, np.full(count, -1), np.full(count, np.nan)


@njit(cache=True)
def tangent(image):
    """Return x / z, y / z (N, 2) of vectors (N, 3) in front of the camera."""
    seen = np.empty((len(image), 2))
    for i in range(len(image)):
        seen[i, 0] = image[i, 0] / image[i, 2]
        seen[i, 1] = image[i, 1] / image[i, 2]
    return seen


@njit(cache=True)
def support_weights(image, sigma, base, tolerance_sigmas):
    """Return how to predict other image stars from three: weights (K, 3), reach (K,) in rad.

    Written as a sum of the corners of the triangle a star needs no attitude to be
    predicted, and a wrong focal length cancels. The stars that the triangle predicts best
    are chosen.
    """
    a, b, c = image[base[0]], image[base[1]], image[base[2]]
    whole = volume(a, b, c)
    count = len(image)
    weights = np.zeros((count, 3))
    reach = np.full(count, np.inf)
    for i in range(count):
        if i == base[0] or i == base[1] or i == base[2]:
            continue
        star = image[i]
        weights[i, 0] = volume(star, b, c) / whole
        weights[i, 1] = volume(a, star, c) / whole
        weights[i, 2] = volume(a, b, star) / whole
        square = sigma[i] ** 2
        for k in range(3):
            square += (weights[i, k] * sigma[base[k]]) ** 2
        if np.isfinite(square):
            reach[i] = tolerance_sigmas * np.sqrt(square)
    chosen = np.argsort(reach)[:SUPPORTERS]
    chosen = chosen[np.isfinite(reach[chosen])]
    return weights[chosen], reach[chosen]


@njit(cache=True, inline='always')
def volume(a, b, c):
    """Return the triple product a . (b x c)."""
    return (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0]))


@njit(cache=True)
def support(court, weights, reach, first, second, third):
    """Return how many predicted image stars are at a catalogue star, if three are these stars."""
    sky = court.sky
    a, b, c = sky.direction[first], sky.direction[second], sky.direction[third]
    count = 0
    for i in range(len(reach)):
        x = weights[i, 0] * a[0] + weights[i, 1] * b[0] + weights[i, 2] * c[0]
        y = weights[i, 0] * a[1] + weights[i, 1] * b[1] + weights[i, 2] * c[1]
        z = weights[i, 0] * a[2] + weights[i, 1] * b[2] + weights[i, 2] * c[2]
        length = np.sqrt(x * x + y * y + z * z)
        count += nearest(sky, x / length, y / length, z / length, reach[i])[0] >= 0
    return count


@njit(cache=True)
def _chosen(seen, sigma, ratio, matched, sky):
    """Return sensor (M, 3) and ICRF (M, 3) directions and weights (M,) of the matched stars."""
    count = np.count_nonzero(matched >= 0)
    sensor, icrf, weight = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    row = 0
    for i in range(len(matched)):
        if matched[i] < 0:
            continue
        x, y = seen[i, 0] / ratio, seen[i, 1] / ratio
        length = np.sqrt(x * x + y * y + 1)
        sensor[row, 0], sensor[row, 1], sensor[row, 2] = x / length, y / length, 1 / length
        icrf[row] = sky.direction[matched[i]]
        weight[row] = 1 / sigma[i] ** 2
        row += 1
    return sensor, icrf, weight


@njit(cache=True)
def _farthest(vectors):
    """Return the vector (N, 3) that is farthest from the first."""
    chosen, most = 0, -1.0
    for i in range(1, len(vectors)):
        square = ((vectors[i, 0] - vectors[0, 0]) ** 2 + (vectors[i, 1] - vectors[0, 1]) ** 2
                  + (vectors[i, 2] - vectors[0, 2]) ** 2)
        if square > most:
            chosen, most = i, square
    return chosen


@njit(cache=True)
def _scale(matrix, sensor, icrf):
    """Return the focal length that fits over the one of the sensor directions (M, 3).

    Taken from the distances of the stars from their own centre: were they taken from the
    axis, stars on one side of the image would hide a wrong scale in a wrong attitude.
    """
    count = len(sensor)
    expected = np.empty((count, 2))
    seen = np.empty((count, 2))
    centre = np.zeros(4)
    for i in range(count):
        c = icrf[i]
        z = matrix[0, 2] * c[0] + matrix[1, 2] * c[1] + matrix[2, 2] * c[2]
        for k in range(2):
            expected[i, k] = (matrix[0, k] * c[0] + matrix[1, k] * c[1] + matrix[2, k] * c[2]) / z
            seen[i, k] = sensor[i, k] / sensor[i, 2]
            centre[k] += seen[i, k] / count
            centre[2 + k] += expected[i, k] / count
    both = square = 0.0
    for i in range(count):
        for k in range(2):
            away = expected[i, k] - centre[2 + k]
            both += (seen[i, k] - centre[k]) * away
            square += away * away
    return both / square


@njit(cache=True)
def _pair_up(sky, matrix, seen, ratio, radius):
    """Return the catalogue star (N,) nearest to each image star and its distance (N,) in x / z.

    One to one: of several image stars at one star the nearest has it. -1 and NaN beyond the
    radius.
    """
    count = len(seen)
    matched = np.full(count, -1)
    distance = np.full(count, np.nan)
    for i in range(count):
        x, y = seen[i, 0] / ratio, seen[i, 1] / ratio
        length = np.sqrt(x * x + y * y + 1)
        star, _ = nearest(
            sky, (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / length,
            (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / length,
            (matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]) / length, radius)
        if star < 0:
            continue
        c = sky.direction[star]
        z = matrix[0, 2] * c[0] + matrix[1, 2] * c[1] + matrix[2, 2] * c[2]
        dx = (matrix[0, 0] * c[0] + matrix[1, 0] * c[1] + matrix[2, 0] * c[2]) / z - x
        dy = (matrix[0, 1] * c[0] + matrix[1, 1] * c[1] + matrix[2, 1] * c[2]) / z - y
        gap = np.sqrt(dx * dx + dy * dy)
        if gap > radius:
            continue
        for other in range(i):
            if matched[other] == star:
                if distance[other] <= gap:
                    star = -1
                else:
                    matched[other], distance[other] = -1, np.nan
                break
        if star >= 0:
            matched[i], distance[i] = star, gap
    return matched, distance


@njit(cache=True)
def _independent(seen, matched, edge):
    """Return how many square cells of an edge hold image stars (N, 2), and how many matched ones."""
    cells = np.floor(seen / edge)
    every = known = 0
    for i in range(len(seen)):
        new = new_known = True
        for j in range(i):
            if cells[j, 0] == cells[i, 0] and cells[j, 1] == cells[i, 1]:
                new = False
                if matched[j] >= 0:
                    new_known = False
        every += new
        known += new_known and matched[i] >= 0
    return every, known


@njit(cache=True)
def _binomial_tail(least, trials, chance):
    """Return the probability of least or more successes."""
    if least <= 0 or chance >= 1:
        return 1.0
    term = 1.0
    for k in range(least):
        term *= (trials - k) / (k + 1) * chance
    term *= (1 - chance) ** (trials - least)
    total = 0.0
    for k in range(least, trials + 1):
        total += term
        term *= (trials - k) / (k + 1) * chance / (1 - chance)
    return min(total, 1.0)


def _order_chances() -> np.ndarray:
    """Return the share of the orders of n things with at most k inversions, (n, k)."""
    chances = np.ones((_ORDERED + 1, _ORDERED * (_ORDERED - 1) // 2 + 1))
    counts = np.ones(1)
    for n in range(2, _ORDERED + 1):
        # The n-th thing may come before any number of the others.
        counts = np.convolve(counts, np.ones(n)) / n
        chances[n, :len(counts)] = np.minimum(np.cumsum(counts), 1)
    return chances


_ORDER_CHANCES = _order_chances()


@njit(cache=True)
def _order_chance(star, base, without_base):
    """Return the chance that the brightest matched stars come in so good an order.

    Image stars and catalogue stars both go from bright to faint.
    """
    ordered = np.empty(_ORDERED, np.int64)
    count = inversions = 0
    for i in range(len(star)):
        if star[i] < 0 or (without_base and np.any(base == i)):
            continue
        for other in ordered[:count]:
            inversions += other > star[i]
        ordered[count] = star[i]
        count += 1
        if count == _ORDERED:
            break
    return _ORDER_CHANCES[count, inversions]


@njit(cache=True)
def judge(court, seen, sigma, base, star, tested):
    """Return chance, focal ratio, star (N,) and distance (N,) of a candidate.

    seen (N, 2) are the image stars in x / z, y / z; distance is measured there. A chance of
    one stands for a candidate that is refuted.
    """
    sky = court.sky
    count = len(seen)
    radius = court.tolerance_sigmas * np.median(sigma)
    matched = np.full(count, -1)
    matched[base] = star
    distance = np.full(count, np.nan)
    ratio = 1.0
    matrix = np.empty((3, 3))
    # The first radius allows for the attitude that three close stars extrapolate.
    for attempt in range(3):
        before = matched
        sensor, icrf, weight = _chosen(seen, sigma, ratio, matched, sky)
        if attempt == 0:
            matrix = triad(sensor, icrf, 0, _farthest(sensor))
        determinant = refine(matrix, sensor, icrf, weight, 2)[1]
        if not determinant > 0:
            return 1.0, ratio, matched, distance
        if court.scale_error > 0:
            ratio *= _scale(matrix, sensor, icrf)
        if len(weight) == 3:
            # Three close stars alone may know the scale less well than it was known before.
            ratio = min(max(ratio, 1 - court.scale_error), 1 + court.scale_error)
        matched, distance = _pair_up(sky, matrix, seen, ratio,
                                     3 * radius if attempt == 0 else radius)
        if np.count_nonzero(matched >= 0) < 4:
            return 1.0, ratio, matched, distance
        if attempt and np.all(matched == before):
            break
    spread = 0.0
    known = matched >= 0
    for k in range(2):
        along = seen[:, k][known]
        spread += np.sum((along - np.mean(along)) ** 2)
    if abs(ratio - 1) > court.scale_error + radius / np.sqrt(spread):
        return 1.0, ratio, matched, distance
    low_x, high_x, low_y, high_y, chord = court.field
    in_field = count_in_image(sky, matrix, chord, low_x / ratio, high_x / ratio, low_y / ratio,
                              high_y / ratio)
    every, agreeing = _independent(seen, matched, np.sqrt(court.area) / _CELLS)
    # The stars that found the candidate are no evidence for it.
    others = max(agreeing - len(base), 0)
    trials = max(every - len(base), others)
    by_chance = min(1.0, max(in_field, 1) * np.pi * radius ** 2 / court.area)
    emptier = np.searchsorted(court.counts, in_field, 'right') / len(court.counts)
    share = max(emptier, 1 / len(court.counts))
    both = (_binomial_tail(others, trials, by_chance) * share
            * _order_chance(matched, base, court.bases_by_brightness))
    # The probability that the product of two uniform numbers is so small.
    combined = both * (1 - np.log(both)) if both > 0 else 0.0
    return min(1.0, max(tested, 1) * combined), ratio, matched, distance


@njit(cache=True)
def fit(sky, seen, sigma, ratio, star):
    """Return quaternion (4,), covariance (3, 3), residual_rad (M,) and chi2 of a match."""
    sensor, icrf, weight = _chosen(seen, sigma, ratio, star, sky)
    if len(weight) < 2:
        return np.zeros(4), np.full((3, 3), np.inf), np.zeros(len(weight)), np.inf
    matrix = triad(sensor, icrf, 0, _farthest(sensor))
    covariance, _ = refine(matrix, sensor, icrf, weight, 5)
    residual = np.empty(len(weight))
    chi2 = 0.0
    for i in range(len(weight)):
        square = 0.0
        for k in range(3):
            square += (icrf[i, k] - matrix[k, 0] * sensor[i, 0] - matrix[k, 1] * sensor[i, 1]
                       - matrix[k, 2] * sensor[i, 2]) ** 2
        residual[i] = 2 * np.arcsin(np.sqrt(square) / 2)
        chi2 += residual[i] ** 2 * weight[i]
    return quaternion_from_matrix(matrix), covariance, residual, chi2
