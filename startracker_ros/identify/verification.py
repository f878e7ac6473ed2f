"""
Whether a candidate attitude is right: all stars of the field, and what chance would do.

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

So are the distances of the matched stars: by chance they would be spread over the matching
radius, where those of true matches gather at its centre.

A lens that is not what it is taken for leaves a trace of its own: around the few stars that do
match, the others lie near catalogue stars, more often than chance would have it, but not
at them. Such a candidate is refuted, however unlikely its matches are.

The three chances together, as Fisher (1925) combines them, times the number of candidates
that were tested, are the false-alarm probability.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.attitude.refinement import (
    quaternion_from_matrix, refine, residuals, sensor_directions)
from startracker_ros.attitude.triad import triad
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import StarPlaces
from startracker_ros.catalog.sky_grid import count_in_image, nearest, sky_grid, SkyGrid
from startracker_ros.compiled import compiled, inlined

# Image stars that are looked up for each candidate, and candidates that are then judged.
SUPPORTERS = 8
JUDGED = 5
# Random directions at which the emptiness of the sky is sampled.
_SAMPLES = 2000
# Matched stars whose order is looked at.
_ORDERED = 12
# Image stars without a match count as near misses up to so many matching radii from a star;
# so improbable a number of them is the lens, not chance.
_NEAR_MISS_RADII = 8.0
_NEAR_MISS_CHANCE = 1e-3
# Cells along one side of a square image: 3/4 of a degree in a field of 12.
_CELLS = 16


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
        """
        Return the candidates (K,) that further image stars support, the best first.

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
        """
        Return how well the field fits when image stars base (B,) are the stars star (B,).

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


@compiled
def same_attitude(star: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two answers agree about two stars, which leaves no room for two attitudes."""
    agreeing = 0
    for i in range(len(star)):
        agreeing += star[i] >= 0 and star[i] == other[i]
    return agreeing >= 2


@compiled
def refuted(count: int) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return the verdict of a candidate that names none of count stars."""
    return 1.0, 1.0, np.full(count, -1), np.full(count, np.nan)


@compiled
def tangent(image: np.ndarray) -> np.ndarray:
    """Return x / z, y / z (N, 2) of vectors (N, 3) in front of the camera."""
    seen = np.empty((len(image), 2))
    for i in range(len(image)):
        seen[i, 0] = image[i, 0] / image[i, 2]
        seen[i, 1] = image[i, 1] / image[i, 2]
    return seen


@compiled
def support_weights(image: np.ndarray, sigma: np.ndarray, base: np.ndarray, tolerance_sigmas: float
                    ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how to predict other image stars from three: weights (K, 3), reach (K,) in rad.

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
        if square < np.inf:
            reach[i] = tolerance_sigmas * np.sqrt(square)
    kept = 0
    for _ in range(min(SUPPORTERS, count)):
        least = kept
        for i in range(kept, count):
            if reach[i] < reach[least]:
                least = i
        if not reach[least] < np.inf:
            break
        reach[kept], reach[least] = reach[least], reach[kept]
        for k in range(3):
            weights[kept, k], weights[least, k] = weights[least, k], weights[kept, k]
        kept += 1
    return weights[:kept], reach[:kept]


@inlined
def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return the triple product a . (b x c)."""
    return (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0]))


@compiled
def support(court: Court, weights: np.ndarray, reach: np.ndarray, first: int, second: int,
            third: int) -> int:
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


@compiled
def _chosen(seen: np.ndarray, sigma: np.ndarray, ratio: float, matched: np.ndarray, sky: SkyGrid
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sensor (M, 3) and ICRF (M, 3) directions and weights (M,) of the matched stars."""
    count = matches(matched)
    sensor, icrf, weight = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    row = 0
    for i in range(len(matched)):
        if matched[i] < 0:
            continue
        x, y = seen[i, 0] / ratio, seen[i, 1] / ratio
        length = np.sqrt(x * x + y * y + 1)
        sensor[row, 0], sensor[row, 1], sensor[row, 2] = x / length, y / length, 1 / length
        for k in range(3):
            icrf[row, k] = sky.direction[matched[i], k]
        weight[row] = 1 / sigma[i] ** 2
        row += 1
    return sensor, icrf, weight


@compiled
def _farthest(vectors: np.ndarray) -> int:
    """Return the vector (N, 3) that is farthest from the first."""
    chosen, most = 0, -1.0
    for i in range(1, len(vectors)):
        square = ((vectors[i, 0] - vectors[0, 0]) ** 2 + (vectors[i, 1] - vectors[0, 1]) ** 2
                  + (vectors[i, 2] - vectors[0, 2]) ** 2)
        if square > most:
            chosen, most = i, square
    return chosen


@compiled
def matches(matched: np.ndarray) -> int:
    """Return how many of the image stars (N,) have a catalogue star."""
    count = 0
    for star in matched:
        count += star >= 0
    return count


@compiled
def _equal(matched: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two answers are the same."""
    for i in range(len(matched)):
        if matched[i] != other[i]:
            return False
    return True


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
def _up_to(values: np.ndarray, limit: int) -> int:
    """Return how many of the ascending values (N,) are not above a limit."""
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) // 2
        if values[middle] <= limit:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def _spread(seen: np.ndarray, matched: np.ndarray) -> float:
    """Return the root of the summed square distances of the matched stars from their centre."""
    count = 0
    x = y = xx = yy = 0.0
    for i in range(len(seen)):
        if matched[i] >= 0:
            count += 1
            x += seen[i, 0]
            y += seen[i, 1]
            xx += seen[i, 0] ** 2
            yy += seen[i, 1] ** 2
    return np.sqrt(max(xx + yy - (x * x + y * y) / count, 0.0))


@compiled
def _scale(matrix: np.ndarray, sensor: np.ndarray, icrf: np.ndarray) -> float:
    """
    Return the focal length that fits over the one of the sensor directions (M, 3).

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


@inlined
def _star_at(sky: SkyGrid, matrix: np.ndarray, x: float, y: float, radius: float
             ) -> tuple[int, float]:
    """Return the catalogue star nearest to x / z, y / z in the sensor frame, as nearest()."""
    length = np.sqrt(x * x + y * y + 1)
    return nearest(sky, (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / length,
                   (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / length,
                   (matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]) / length, radius)


@compiled
def _pair_up(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float, radius: float
             ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the catalogue star (N,) nearest to each image star and its distance (N,) in x / z.

    One to one: of several image stars at one star the nearest has it. -1 and NaN beyond the
    radius.
    """
    count = len(seen)
    matched = np.full(count, -1)
    distance = np.full(count, np.nan)
    for i in range(count):
        x, y = seen[i, 0] / ratio, seen[i, 1] / ratio
        star, _ = _star_at(sky, matrix, x, y, radius)
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


@compiled
def _cells(seen: np.ndarray, matched: np.ndarray, edge: float) -> tuple[int, np.ndarray]:
    """
    Return how many square cells of an edge hold image stars (N, 2), and the first matched (N,).

    The latter are True for the brightest matched star of each cell.
    """
    count = len(seen)
    cell = np.empty((count, 2), np.int64)
    first = np.zeros(count, np.bool_)
    every = 0
    for i in range(count):
        cell[i, 0], cell[i, 1] = np.floor(seen[i, 0] / edge), np.floor(seen[i, 1] / edge)
        new, first[i] = True, matched[i] >= 0
        for j in range(i):
            if cell[j, 0] == cell[i, 0] and cell[j, 1] == cell[i, 1]:
                new = False
                first[i] = first[i] and not first[j]
        every += new
    return every, first


@compiled
def _binomial_tail(least: int, trials: int, chance: float) -> float:
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


@compiled
def _order_chance(star: np.ndarray, chosen: np.ndarray) -> float:
    """
    Return the chance that the first chosen (N,) bool stars come in so good an order.

    Image stars and catalogue stars both go from bright to faint.
    """
    ordered = np.empty(_ORDERED, np.int64)
    count = inversions = 0
    for i in range(len(star)):
        if not chosen[i]:
            continue
        for j in range(count):
            inversions += ordered[j] > star[i]
        ordered[count] = star[i]
        count += 1
        if count == _ORDERED:
            break
    return _ORDER_CHANCES[count, inversions]


@compiled
def _distance_chance(distance: np.ndarray, radius: float, base: int) -> float:
    """
    Return a bound of the chance that matched stars are so near to their places.

    distance (N,) is NaN where there is no match. The square of a distance, in squares of the
    radius, is uniform for a point thrown into the circle; x^m / m! bounds the probability that
    m such numbers have a sum below x. The stars that found the candidate, base of them, and the
    fit have taken their part: they add to the sum but not to the number.
    """
    count = 0
    total = 0.0
    for gap in distance:
        if gap >= 0:
            count += 1
            total += (gap / radius) ** 2
    bound = 1.0
    for k in range(count - base):
        bound *= total / (k + 1)
    return min(bound, 1.0)


@compiled
def _near_misses(sky: SkyGrid, matrix: np.ndarray, seen: np.ndarray, ratio: float, radius: float,
                 matched: np.ndarray) -> tuple[int, int]:
    """Return how many image stars without a match there are, and how many near a free star."""
    free = near = 0
    for i in range(len(seen)):
        if matched[i] >= 0:
            continue
        free += 1
        star, _ = _star_at(sky, matrix, seen[i, 0] / ratio, seen[i, 1] / ratio,
                           _NEAR_MISS_RADII * radius)
        near += star >= 0 and not _contains(matched, star)
    return free, near


@compiled
def _contains(matched: np.ndarray, star: int) -> bool:
    """Return whether a catalogue star is among the matched ones."""
    for other in matched:
        if other == star:
            return True
    return False


@compiled
def judge(court: Court, seen: np.ndarray, sigma: np.ndarray, base: np.ndarray, star: np.ndarray,
          tested: int) -> tuple[float, float, np.ndarray, np.ndarray]:
    """
    Return chance, focal ratio, star (N,) and distance (N,) of a candidate.

    seen (N, 2) are the image stars in x / z, y / z; distance is measured there. A chance of
    one stands for a candidate that is refuted.
    """
    sky = court.sky
    count = len(seen)
    radius = court.tolerance_sigmas * _middle(sigma)
    matched = np.full(count, -1)
    for i in range(len(base)):
        matched[base[i]] = star[i]
    distance = np.full(count, np.nan)
    ratio = fitted = 1.0
    matrix = np.empty((3, 3))
    # The first radius allows for the attitude that three close stars extrapolate; looked at
    # twice, because the stars found first lead to those at the far side of the image.
    for attempt in range(4):
        before = matched
        sensor, icrf, weight = _chosen(seen, sigma, ratio, matched, sky)
        if attempt == 0:
            matrix = triad(sensor, icrf, 0, _farthest(sensor))
        determinant = refine(matrix, sensor, icrf, weight)[1]
        if not determinant > 0:
            return 1.0, ratio, matched, distance
        fitted = ratio * _scale(matrix, sensor, icrf)
        # Close stars may know the scale less well than it was known before.
        ratio = min(max(fitted, 1 - court.scale_error), 1 + court.scale_error)
        matched, distance = _pair_up(sky, matrix, seen, ratio,
                                     3 * radius if attempt < 2 else radius)
        if matches(matched) < 4:
            return 1.0, ratio, matched, distance
        if attempt > 1 and _equal(matched, before):
            break
    if abs(fitted - 1) > court.scale_error + radius / _spread(seen, matched):
        return 1.0, ratio, matched, distance
    low_x, high_x, low_y, high_y, chord = court.field
    in_field = count_in_image(sky, matrix, chord, low_x / ratio, high_x / ratio, low_y / ratio,
                              high_y / ratio)
    every, first = _cells(seen, matched, np.sqrt(court.area) / _CELLS)
    agreeing = 0
    for i in range(count):
        agreeing += first[i]
    # The stars that found the candidate are no evidence for it.
    others = max(agreeing - len(base), 0)
    trials = max(every - len(base), others)
    by_chance = min(1.0, max(in_field, 1) * np.pi * radius ** 2 / court.area)
    share = max(_up_to(court.counts, in_field), 1) / len(court.counts)
    if court.bases_by_brightness:
        for i in base:
            first[i] = False
    product = (_binomial_tail(others, trials, by_chance) * share * _order_chance(matched, first)
               * _distance_chance(distance, radius, len(base)))
    # The probability that the product of three uniform numbers is so small.
    log = -np.log(product) if product > 0 else 0.0
    chance = min(1.0, max(tested, 1) * product * (1 + log + log * log / 2))
    if chance < 1:
        free, near = _near_misses(sky, matrix, seen, ratio, radius, matched)
        if _binomial_tail(near, free, min(
                by_chance * (_NEAR_MISS_RADII ** 2 - 1), 1.0)) < _NEAR_MISS_CHANCE:
            chance = 1.0
    return chance, ratio, matched, distance


@compiled
def fit(sky: SkyGrid, seen: np.ndarray, sigma: np.ndarray, ratio: float, star: np.ndarray
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return quaternion (4,), covariance (3, 3), residual_rad (M,) and chi2 of a match."""
    sensor, icrf, weight = _chosen(seen, sigma, ratio, star, sky)
    if len(weight) < 2:
        return np.zeros(4), np.full((3, 3), np.inf), np.zeros(len(weight)), np.inf
    matrix = triad(sensor, icrf, 0, _farthest(sensor))
    covariance, _ = refine(matrix, sensor, icrf, weight)
    residual = residuals(sensor, sensor_directions(matrix, icrf))
    chi2 = np.sum(residual ** 2 * weight)
    return quaternion_from_matrix(matrix), covariance, residual, chi2
