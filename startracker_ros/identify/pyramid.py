"""
Triangles of image stars among the catalogue pairs, confirmed by the other stars: Pyramid.

Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique,
Navigation 51 (2004). Two sides of a triangle are looked up by k-vector and joined through
their common star, as the identifier array of Yuan, Zhang, Shi (2017) does it. This is the
solver for general use, compiled throughout.
"""

import time
from typing import NamedTuple

from numba import objmode, types
from numba.experimental import structref
import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera.lens import Lens
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.compiled import compiled, inlined
from startracker_ros.identify.cache import cached_pairs
from startracker_ros.identify.identification import (
    Identification, IdentificationOptions, Identifier, spread, usable_stars)
from startracker_ros.identify.kvector import first_beyond, first_from, KVectorTable
from startracker_ros.identify.pairing import fit, matches
from startracker_ros.identify.pairs import PairDatabase
from startracker_ros.identify.support import support, support_weights, SUPPORTERS, volume
from startracker_ros.identify.verification import (
    Court, judge, JUDGED, refuted, same_attitude, tangent)

# Sides of a triangle shorter than this say little beside their noise.
_MIN_SEPARATION_PX = 20.0
# Focal lengths that are searched at once, as a share of them to either side.
_BAND = 0.005
# A triangle flatter than this many sigmas of its own height has no sure handedness.
_FLAT_SIGMAS = 4.0
# Triangles are made of so many of the brightest stars, at any time of the most trusted ones.
_IMAGE_STARS = 40
_TRUSTED = 9
# The first triangles, of the very brightest, are looked up among the brightest catalogue stars:
# few pairs, all of them near the processor.
_BRIGHT_STARS_PER_FIELD = 5.0
_BRIGHT_IMAGE_STARS = 4
_BRIGHT_TRIANGLES = 3
# Trust in a star relative to the next brighter one: nine of ten, a start without evidence.
_FAINTER_TRUST = 0.9
# What a triangle costs in any case, what a pair of a side and a joined pair of pairs cost, in ns.
_COST, _PAIR_COST, _JOIN_COST = 4000.0, 4.0, 8.0
# Work between two looks at the clock, in the same measure: 10 ms.
_BUDGET = 1e7
_BELIEVED, _TOO_FEW, _AMBIGUOUS, _EXHAUSTED, _TIME_LIMIT = range(5)


class _Pairs(NamedTuple):
    """
    A pair database and room to work in, for the compiled functions.

    star (S,) are indices into the places, direction (S, 3) their unit vectors. A join lists
    the partners of star s from head[s] on, through following. The upper half of head[s] is the
    number of the join that wrote it, head[S] that of the last join. image_stars and
    triangles limit what is looked up here.
    """

    table: KVectorTable
    first: np.ndarray
    second: np.ndarray
    star: np.ndarray
    direction: np.ndarray
    head: np.ndarray
    following: np.ndarray
    image_stars: int
    triangles: int


class _State(NamedTuple):
    """
    How far the search of one frame has come, for its n brightest stars.

    trust (n,); found (n, n) pairs that a side may be, -1 unknown; used (n, n, n) triangles.
    """

    trust: np.ndarray
    found: np.ndarray
    used: np.ndarray


@structref.register
class _SkyType(types.StructRef):
    """The compiled type of _Sky."""

    def preprocess_fields(self, fields: tuple) -> tuple:
        """Return the fields without the values that they happen to have."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class _Sky(structref.StructRefProxy):
    """
    All that stays the same from frame to frame, handed over as one reference.

    Handed over one by one, the arrays would take as long as the search itself.
    """

    levels: tuple[_Pairs, _Pairs]
    court: Court
    lens: Lens


structref.define_proxy(_Sky, _SkyType, ['levels', 'court', 'lens'])


@compiled
def _sky(levels: tuple[_Pairs, _Pairs], court: Court, lens: Lens) -> _Sky:
    """Return the reference; a compiled function, because that one is cached."""
    return _Sky(levels, court, lens)


class PyramidIdentifier(Identifier):
    """Triangles of image stars, looked up side by side, confirmed by all other stars."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        pairs = cached_pairs(self.places, _MIN_SEPARATION_PX * camera.pixel_rad,
                             2 * camera.corner_angle_rad * (1 + self.scale_error))
        share = camera.fov_x_rad * camera.fov_y_rad / (4 * np.pi)
        bright = int(np.searchsorted(pairs.star, _BRIGHT_STARS_PER_FIELD / share))
        levels = (self._room(pairs.among(bright), _BRIGHT_IMAGE_STARS, _BRIGHT_TRIANGLES),
                  self._room(pairs, _IMAGE_STARS, _IMAGE_STARS ** 3))
        self._sky = _sky(levels, self.verifier.court, camera.lens)
        # Compiles at the first use on a machine: no frame is to wait for it.
        self.identify(Centroids.empty())

    def _room(self, pairs: PairDatabase, image_stars: int, triangles: int) -> _Pairs:
        return _Pairs(
            pairs.kvector.table, pairs.first, pairs.second, pairs.star,
            self.places.direction[pairs.star], np.zeros(len(pairs.star) + 1, np.int64),
            np.zeros(2 * len(pairs.first), np.int32), image_stars, triangles)

    def identify(self, centroids: Centroids) -> Identification:
        """Return the answer of the first believed triangle."""
        options = self.options
        outcome, used, tested, chance, ratio, matched, found, fitted = _identify(
            self._sky, centroids.uv, -centroids.flux, centroids.sigma_px,
            options.max_image_stars, options.sigma_floor_px, options.false_alarm_max,
            time.perf_counter() + options.time_limit_s)
        if outcome == _BELIEVED:
            hip, magnitude, residual_px = found
            return Identification('identified', f'{matched} stars', hip, magnitude, residual_px,
                                  AttitudeEstimate(fitted[0], fitted[1], matched, *fitted[2:]),
                                  ratio, chance)
        if outcome == _TOO_FEW:
            return self.too_few(centroids, used)
        if outcome == _AMBIGUOUS:
            return self.nothing(centroids, 'ambiguous', 'two attitudes fit the field', chance)
        if outcome == _TIME_LIMIT:
            return self.time_limit(centroids, tested, chance)
        return self.no_candidate(centroids, used, tested, chance)


@compiled
def _identify(constant: _Sky, uv: np.ndarray, faintness: np.ndarray, sigma_px: np.ndarray,
              most: int, sigma_floor_px: float, false_alarm_max: float, deadline_s: float
              ) -> tuple[int, int, int, float, float, int, tuple, tuple]:
    """
    Test triangle after triangle until one is believed, none is left or time is up.

    The centroids at uv (N, 2) come in the order of faintness (N,), any ascending measure.
    Return the outcome, how many stars were used, candidates tested, chance, focal ratio,
    number of matched stars, (hip, magnitude, residual_px) of all centroids and fit().
    """
    court, lens = constant.court, constant.lens
    index, image, sigma = usable_stars(lens, uv, np.argsort(faintness), sigma_px, most,
                                       sigma_floor_px)
    seen = tangent(image)
    chance, ratio, star, distance, matrix = refuted(len(image))
    tested = np.zeros(1, np.int64)
    base = np.empty(3, np.int64)
    outcome = _TOO_FEW if len(image) < 4 else _EXHAUSTED
    spent = 0.0
    for level in constant.levels:
        state = _begin(len(image), level.image_stars)
        for _ in range(level.triangles):
            cost = _choose(level.table.values, len(level.star), court.tolerance_sigmas,
                           court.scale_error, image, sigma, state, base)
            if cost < 0 or outcome != _EXHAUSTED:
                break
            candidates, count = _candidates(level, court, image, sigma, base, tested)
            believed = 0
            for row in range(count):
                verdict = judge(court, seen, sigma, base, candidates[row], tested[0])
                if verdict[0] <= false_alarm_max and (
                        not believed or not same_attitude(verdict[2], star)):
                    believed += 1
                if verdict[0] < chance:
                    chance, ratio, star, distance, matrix = verdict
            if believed:
                outcome = _AMBIGUOUS if believed > 1 else _BELIEVED
                break
            spent += cost + count * _COST
            if spent > _BUDGET:
                spent = 0.0
                with objmode(now_s='float64'):
                    now_s = time.perf_counter()
                if now_s > deadline_s:
                    outcome = _TIME_LIMIT
    residual_px = distance * np.sqrt(lens.fx * lens.fy)
    return (outcome, len(index), tested[0], chance, ratio, matches(star),
            spread(len(uv), index, star, residual_px, court.hip, court.magnitude),
            fit(court.sky, seen, sigma, ratio, star, matrix))


@compiled
def _begin(count: int, most: int) -> _State:
    """Return the state of a search of count stars at its beginning, at most so many used."""
    n = min(count, most)
    trust = np.empty(n)
    for i in range(n):
        trust[i] = _FAINTER_TRUST ** i
    return _State(trust, np.full((n, n), -1.0), np.zeros((n, n, n), np.bool_))


@compiled
def _angle_and_noise(image: np.ndarray, sigma: np.ndarray, tolerance_sigmas: float, i: int,
                     j: int) -> tuple[float, float]:
    """Return the length of a side and how far noise may take its catalogue pairs off it."""
    x, y = image[i, 0] - image[j, 0], image[i, 1] - image[j, 1]
    z = image[i, 2] - image[j, 2]
    angle = 2 * np.arcsin(min(np.sqrt(x * x + y * y + z * z) / 2, 1.0))
    return angle, tolerance_sigmas * np.sqrt(sigma[i] ** 2 + sigma[j] ** 2)


@inlined
def _bands(scale_error: float) -> int:
    """Return in how many parts the tolerance of the focal length is searched."""
    return max(int(np.ceil(scale_error / _BAND)), 1)


@compiled
def _expected_pairs(separations: np.ndarray, stars: int, angle: float, reach: float) -> float:
    """
    Return how many pairs a side may be, were the stars spread evenly over the sky.

    Faster than to look; nothing where the database has no such pairs at all.
    """
    if (not len(separations) or angle + reach < separations[0]
            or angle - reach > separations[-1]):
        return 0.0
    return stars ** 2 / 4 * np.sin(angle) * 2 * reach


@compiled
def _descending(values: np.ndarray) -> np.ndarray:
    """Return the order of a few values (N,) from the greatest to the least."""
    order = np.arange(len(values))
    for i in range(1, len(order)):
        moved = order[i]
        j = i
        while j > 0 and values[order[j - 1]] < values[moved]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = moved
    return order


@compiled
def _choose(separations: np.ndarray, stars: int, tolerance_sigmas: float, scale_error: float,
            image: np.ndarray, sigma: np.ndarray, state: _State, base: np.ndarray) -> float:
    """
    Put the next triangle into base (3,) and return its cost, negative when none is left.

    separations (P,) are those of the pairs of so many stars.

    The next one has the most trust for its cost. Trust starts a little higher for bright
    stars and halves for the three stars of each triangle that is asked to be followed by
    another, so that a false star is soon left aside (the aim of the order of Mortari et
    al. 2004, figure 5); the cost is that of joining the pairs of the two shorter sides. The
    two shorter sides meet in the first of base.
    """
    trust, found, used = state.trust, state.found, state.used
    order = _descending(trust)
    size = max(stars, 1) * _bands(scale_error)
    # The triangles of the most trusted stars come first, all others when these are used up.
    for reach in (min(_TRUSTED, len(trust)), len(trust)):
        most, chosen_cost = 0.0, -1.0
        for x in range(reach):
            for y in range(x):
                i, j = order[x], order[y]
                if found[i, j] < 0:
                    angle, noise = _angle_and_noise(image, sigma, tolerance_sigmas, i, j)
                    found[i, j] = found[j, i] = _expected_pairs(
                        separations, stars, angle, noise + scale_error * angle)
                if not found[i, j]:
                    continue
                for z in range(y):
                    k = order[z]
                    ik, jk = found[i, k], found[j, k]
                    if not ik or not jk or used[i, j, k]:
                        continue
                    longest = max(found[i, j], ik, jk)
                    both = found[i, j] + ik + jk - longest
                    joined = 4.0 * found[i, j] * ik * jk / longest / size
                    cost = _COST + _PAIR_COST * both + _JOIN_COST * joined
                    value = trust[i] * trust[j] * trust[k] / cost
                    if value > most:
                        most, chosen_cost = value, cost
                        base[0], base[1], base[2] = i, j, k
        if most > 0:
            break
    if chosen_cost < 0:
        return chosen_cost
    i, j, k = base[0], base[1], base[2]
    used[i, j, k] = used[i, k, j] = used[j, i, k] = True
    used[j, k, i] = used[k, i, j] = used[k, j, i] = True
    trust[i] /= 2
    trust[j] /= 2
    trust[k] /= 2
    # The longest side lies across from the first of base.
    if found[i, k] >= max(found[i, j], found[j, k]):
        base[0], base[1] = j, i
    elif found[i, j] >= max(found[i, k], found[j, k]):
        base[0], base[2] = k, i
    return chosen_cost


@compiled
def _candidates(pairs: _Pairs, court: Court, image: np.ndarray, sigma: np.ndarray,
                base: np.ndarray, tested: np.ndarray) -> tuple[np.ndarray, int]:
    """
    Return the best supported catalogue triangles (JUDGED, 3) of an image triangle, how many.

    A triangle fits when its three sides agree with those of the image within the noise, after
    one common scale within its tolerance, and when its handedness agrees. A wide tolerance is
    searched in bands: the pairs to be joined are many fewer. A triangle that all of the
    SUPPORTERS support is the last one: by chance none has them. tested (1,) counts the
    fitting ones.
    """
    tolerance_sigmas, scale_error = court.tolerance_sigmas, court.scale_error
    a, b, c = base[0], base[1], base[2]
    angle0, noise0 = _angle_and_noise(image, sigma, tolerance_sigmas, a, b)
    angle1, noise1 = _angle_and_noise(image, sigma, tolerance_sigmas, a, c)
    angle2, noise2 = _angle_and_noise(image, sigma, tolerance_sigmas, b, c)
    weight0, weight1, weight2 = angle0 / noise0 ** 2, angle1 / noise1 ** 2, angle2 / noise2 ** 2
    full = weight0 * angle0 + weight1 * angle1 + weight2 * angle2
    hand = volume(image, a, b, c)
    flat = (abs(hand) < max(noise0, noise1, noise2) / tolerance_sigmas * _FLAT_SIGMAS
            * max(angle0, angle1, angle2))
    weights, support_reach = support_weights(image, sigma, base, tolerance_sigmas)
    best = np.empty((JUDGED, 3), np.int64)
    votes = np.zeros(JUDGED, np.int64)
    # Taken out of the tuples once: each look into them costs more than what is done with it.
    table, values, sky = pairs.table, pairs.table.values, court.sky
    first, second, names, direction = pairs.first, pairs.second, pairs.star, pairs.direction
    head, following = pairs.head, pairs.following
    found = 0
    bands = _bands(scale_error)
    half = scale_error / bands
    for band in range(bands):
        middle = 1 - scale_error + (2 * band + 1) * half
        least = middle - half if band > 0 else 0.0
        most = middle + half if band < bands - 1 else np.inf
        low = 2 * np.sin(max(middle * angle2 - noise2 - half * angle2, 0.0) / 2)
        high = 2 * np.sin(min(middle * angle2 + noise2 + half * angle2, np.pi) / 2)
        low, high = low * low, high * high
        stamp = _list_partners(
            first, second, head, following,
            first_from(table, middle * angle0 - noise0 - half * angle0),
            first_beyond(table, middle * angle0 + noise0 + half * angle0))
        begin = first_from(table, middle * angle1 - noise1 - half * angle1)
        end = first_beyond(table, middle * angle1 + noise1 + half * angle1)
        # Scalars alone: a view of a row costs more than the arithmetic with it.
        for place in range(2 * begin, 2 * end):
            pair = place >> 1
            meet, third = first[pair], second[pair]
            if place & 1:
                meet, third = third, meet
            if head[meet] >> 32 != stamp:
                continue
            x, y, z = direction[third, 0], direction[third, 1], direction[third, 2]
            entry = np.int32(head[meet])
            while entry >= 0:
                other = first[entry >> 1] if entry & 1 else second[entry >> 1]
                dx, dy = direction[other, 0] - x, direction[other, 1] - y
                dz = direction[other, 2] - z
                square = dx * dx + dy * dy + dz * dz
                if low <= square <= high:
                    side0, side1 = values[entry >> 1], values[pair]
                    side2 = 2 * np.arcsin(np.sqrt(square) / 2)
                    scale = (side0 * weight0 + side1 * weight1 + side2 * weight2) / full
                    alike = (least <= scale < most
                             and abs(side0 - scale * angle0) <= noise0
                             and abs(side1 - scale * angle1) <= noise1
                             and abs(side2 - scale * angle2) <= noise2)
                    if alike and (flat or volume(direction, meet, other, third) * hand > 0):
                        tested[0] += 1
                        a, b, c = names[meet], names[other], names[third]
                        # Far less support than the best one has is chance, as below.
                        found = support(sky, weights, support_reach, a, b, c,
                                        max(votes[-1], votes[0] // 3))
                        _keep(best, votes, a, b, c, found)
                        if found == SUPPORTERS:
                            break
                entry = following[entry]
            if found == SUPPORTERS:
                break
        if found == SUPPORTERS:
            break
    # Far less support than the best one has is chance.
    count = 0
    while count < JUDGED and votes[count] > votes[0] // 3:
        count += 1
    return best, count


@compiled
def _list_partners(first: np.ndarray, second: np.ndarray, head: np.ndarray,
                   following: np.ndarray, begin: int, end: int) -> int:
    """
    List the partners of the stars of some pairs, in both orders; return the stamp.

    Entry 2 p of pair p is its second star, 2 p + 1 its first. The arrays are those of _Pairs.
    """
    stamp = head[-1] + 1
    head[-1] = stamp
    for entry in range(2 * begin, 2 * end):
        star = second[entry >> 1] if entry & 1 else first[entry >> 1]
        known = head[star] >> 32 == stamp
        following[entry] = np.int32(head[star]) if known else -1
        head[star] = stamp << 32 | entry
    return stamp


@inlined
def _keep(best: np.ndarray, votes: np.ndarray, first: int, second: int, third: int, count: int
          ) -> None:
    """Keep the candidates with the most votes, the earlier ones first."""
    if count <= votes[-1]:
        return
    row = len(votes) - 1
    while row > 0 and votes[row - 1] < count:
        votes[row] = votes[row - 1]
        for k in range(3):
            best[row, k] = best[row - 1, k]
        row -= 1
    votes[row] = count
    best[row, 0], best[row, 1], best[row, 2] = first, second, third
