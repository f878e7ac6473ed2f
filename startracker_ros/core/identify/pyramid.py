# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Lost-in-space identification by triangles and the stars that confirm them: Pyramid.

Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique,
Navigation 51 (2004). The steps of the paper and where they are:

1. Choose three image stars, changed so that a false star is soon left: triangle_order.py.
2. Look up the catalogue pairs of two sides by k-vector, join them in the star that they share:
   pair_search.py. The paper compares three lists; here the third side is computed.
3. Keep the triangles whose third side and handedness agree: triangles.py.
4. Confirm with a fourth star. The paper asks for one. Here up to eight rank the triangles
   (support.py), and verification.py accepts one by its false-alarm probability over all stars of
   the field, where the paper bounds the expected number of chance pyramids beforehand.

This is the method for general use, compiled throughout.
"""

from copy import copy
from functools import partial
import math
import time
from typing import NamedTuple, Self

from numba import types
from numba.experimental import structref
import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens, plane_points
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.compiled import compiled
from startracker_ros.core.identify.association import count_matched, fit
from startracker_ros.core.identify.cache import cached_pairs
from startracker_ros.core.identify.clock import search_clock, SearchClock, time_is_up
from startracker_ros.core.identify.false_alarm import least_matches
from startracker_ros.core.identify.identification import (
    Identification, IdentificationOptions, Identifier, per_centroid, usable_stars)
from startracker_ros.core.identify.pair_search import pair_level, PairLevel
from startracker_ros.core.identify.pairs import MOST_PAIRS
from startracker_ros.core.identify.triangle_order import new_state, next_triangle, TRIANGLE_COST
from startracker_ros.core.identify.triangles import catalogue_triangles
from startracker_ros.core.identify.verification import (
    rejected, same_attitude, Verification, VerifierData, verify)
from startracker_ros.core.maths.sorting import upper_median
from startracker_ros.core.stored_arrays import prepare

# The relative noise of shorter sides is too large to be of use.
_MIN_SEPARATION_PX = 20.0
# More than a search within its time limit can test.
_MANY_TRIANGLES = 10 ** 8
# Expected time in ns, as the costs of triangle_order.py: for each image star to predict it from a
# triangle, and to verify a candidate.
_PREDICTION_COST, _VERIFICATION_COST = 60.0, 500.0
_MIN_STARS = 4
# The search ends when a field of the least stars that could be accepted would have been found but
# for this share. A triangle of its stars finds it in so many cases at least: the others have a
# larger error, or less support than a chance one. Looked at after so many triangles.
_MISSED, _FINDS, _LOOK_PERIOD = 0.02, 0.5, 16
# The field is taken to have so few stars as one of ten has: these are the easiest to accept.
_POOREST = 10
_IDENTIFIED, _TOO_FEW, _AMBIGUOUS, _EXHAUSTED, _TIME_LIMIT = range(5)


@structref.register
class _DatabaseType(types.StructRef):
    """The compiled type of _Database."""

    def preprocess_fields(self, fields: tuple) -> tuple:
        """Return the fields without the values that they happen to have."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class _Database(structref.StructRefProxy):
    """
    What stays the same from frame to frame, passed to compiled code as one reference.

    Passed one by one, the arrays would take as long as the search itself.
    """

    levels: tuple[PairLevel, PairLevel]
    verifier: VerifierData
    lens: Lens


structref.define_proxy(_Database, _DatabaseType, ['levels', 'verifier', 'lens'])


@compiled
def _database(levels: tuple[PairLevel, PairLevel], verifier: VerifierData, lens: Lens
              ) -> _Database:
    """Return the reference; a compiled function, because that one is cached."""
    return _Database(levels, verifier, lens)


class BrightLevel(NamedTuple):
    """How many catalogue stars, image stars and triangles the first, brighter level has."""

    stars_per_field: float
    image_stars: int
    triangles: int


# Of the very brightest stars: few pairs, all of them in the processor's cache.
_BRIGHT = BrightLevel(5.0, 4, 3)


class PyramidIdentifier(Identifier):
    """Triangles of image stars, looked up side by side, confirmed by all other stars."""

    min_stars = _MIN_STARS
    most_pairs = MOST_PAIRS

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        self.least_rad = _MIN_SEPARATION_PX * camera.pixel_rad
        self.most_rad = 2 * camera.corner_angle_rad * (1 + self.scale_error)
        self._cached_pairs = partial(
            cached_pairs, self.onboard, self.least_rad, self.most_rad, self.most_pairs)
        self.pairs = self._cached_pairs()
        self._set_levels(_BRIGHT)
        # Compiles at the first use on a machine, before the first frame.
        self.identify(Centroids.empty())

    def _set_levels(self, bright: BrightLevel) -> None:
        """Make the database of all pairs and of those of the brightest stars."""
        share = self.camera.fov_x_rad * self.camera.fov_y_rad / (4 * np.pi)
        self.bright_pairs = self._cached_pairs(
            brightest=int(np.ceil(bright.stars_per_field / share)))
        self._levels = (
            pair_level(self.bright_pairs, bright.image_stars, bright.triangles),
            pair_level(self.pairs, self.options.max_image_stars, _MANY_TRIANGLES))
        self._stored = [made.stored for made in (self.onboard, self.pairs, self.bright_pairs)
                        if made.stored is not None]
        self._database = _database(self._levels, self.verifier.data, self.camera.lens)

    def with_bright_level(self, bright: BrightLevel) -> Self:
        """Return an identifier of the same pairs with another level of the brightest stars."""
        other = copy(self)
        other._set_levels(bright)
        return other

    def with_camera(self, camera: Camera, options: IdentificationOptions) -> Self:
        """
        Return an identifier of another lens, floor, limit of chance or time, same database.

        The camera has about the same field of view and pixels.
        """
        other = copy(self)
        other.options = options
        if camera != self.camera:
            other.camera, other.verifier = camera, self._verifier(camera)
            other._database = _database(self._levels, other.verifier.data, camera.lens)
        return other

    def prepare(self) -> None:
        """Have the database in memory before a short search among many databases."""
        prepare(*self._stored)

    def identify(self, centroids: Centroids) -> Identification:
        """Return the stars of the first triangle that is verified."""
        return self._identified_by(
            centroids, time.thread_time() + self.options.time_limit_s, math.inf)[0]

    def identify_within(self, centroids: Centroids, work_s: float) -> tuple[Identification, float]:
        """
        Return the stars of the first triangle that is verified by so much work, and what it took.

        Work is counted in the seconds that it is expected to take on a processor of 3 GHz, so
        that results are the same on all machines.
        """
        found, work_ns = self._identified_by(centroids, math.inf, 1e9 * work_s)
        return found, 1e-9 * work_ns

    def _identified_by(self, centroids: Centroids, deadline_s: float, most_ns: float
                       ) -> tuple[Identification, float]:
        """Return the result of a search with the limits of a SearchClock, and its work in ns."""
        options = self.options
        outcome, used, tested, false_alarm, ratio, matched, found, fitted, work_ns = _identify(
            self._database, centroids.uv, -centroids.flux, centroids.sigma_px,
            options.max_image_stars, options.sigma_floor_px, options.false_alarm_max,
            deadline_s, most_ns, self.until_s)
        return self._result(centroids, outcome, used, tested, false_alarm, ratio, matched, found,
                            fitted), work_ns

    def _result(self, centroids: Centroids, outcome: int, used: int, tested: int,
                false_alarm: float, ratio: float, matched: int, found: tuple, fitted: tuple
                ) -> Identification:
        if outcome == _IDENTIFIED:
            hip, magnitude, residual_px = found
            return Identification('identified', f'{matched} stars', hip, magnitude, residual_px,
                                  AttitudeEstimate(fitted[0], fitted[1], matched, *fitted[2:]),
                                  ratio, false_alarm)
        if outcome == _TOO_FEW:
            return self.too_few(centroids, used)
        if outcome == _AMBIGUOUS:
            return self.unidentified(centroids, 'ambiguous', 'two attitudes fit the field',
                                     false_alarm)
        if outcome == _TIME_LIMIT:
            return self.time_limit(centroids, tested, false_alarm)
        return self.no_candidate(centroids, used, tested, false_alarm)


@compiled
def _identify(database: _Database, uv: np.ndarray, faintness: np.ndarray, sigma_px: np.ndarray,
              max_stars: int, sigma_floor_px: float, false_alarm_max: float, deadline_s: float,
              most_ns: float, until_s: np.ndarray
              ) -> tuple[int, int, int, float, float, int, tuple, tuple, float]:
    """
    Search, and return the best verification as the result of all centroids.

    The centroids at uv (N, 2) are used in the order of faintness (N,), any ascending measure.
    Return outcome, number of stars used, triangles tested, false-alarm probability, focal ratio,
    number of stars matched, per_centroid(), fit() and the work in ns.
    """
    verifier, lens = database.verifier, database.lens
    index, image, sigma = usable_stars(lens, uv, np.argsort(faintness), sigma_px, max_stars,
                                       sigma_floor_px)
    clock = search_clock(deadline_s, most_ns, until_s)
    outcome, tested, best = _search(database.levels, verifier, image, sigma, false_alarm_max,
                                    clock)
    residual_px = best.residual * np.sqrt(lens.fx * lens.fy)
    # Scalars: a tuple of arrays would cost a microsecond on its way to Python.
    return (outcome, len(index), tested, best.false_alarm, best.focal_ratio,
            count_matched(best.star),
            per_centroid(len(uv), index, best.star, residual_px, verifier.hip,
                         verifier.magnitude),
            fit(verifier.sky, lens.equidistant, plane_points(lens.equidistant, image), sigma,
                best.focal_ratio, best.star, best.matrix), clock.work_ns[1])


@compiled
def _search(levels: tuple[PairLevel, PairLevel], verifier: VerifierData, image: np.ndarray,
            sigma: np.ndarray, false_alarm_max: float, clock: SearchClock
            ) -> tuple[int, int, Verification]:
    """
    Test triangle after triangle until one is verified, none is left or time is up.

    image (N, 3) are unit vectors, sigma (N,) their errors in rad. Return the outcome, how many
    catalogue triangles were tested and the verification of the least false-alarm probability.
    """
    seen = plane_points(verifier.equidistant, image)
    best = rejected(len(image))
    tested = np.zeros(1, np.int64)
    base = np.empty(3, np.int64)
    if len(image) < _MIN_STARS:
        return _TOO_FEW, 0, best
    for level in levels:
        state = new_state(len(image), level.image_stars)
        for looked_up in range(level.triangles):
            if looked_up % _LOOK_PERIOD == _LOOK_PERIOD - 1 and _is_searched(
                    verifier, sigma, len(state.weight), looked_up, tested[0], false_alarm_max):
                break
            cost = next_triangle(level, verifier.tolerance_sigmas, verifier.scale_error, image,
                                 sigma, state, base)
            if cost < 0:
                break
            candidates, count = catalogue_triangles(level, verifier, image, sigma, base, tested,
                                                    clock)
            accepted, best = _verify_all(verifier, seen, sigma, base, candidates[:count],
                                         tested[0], false_alarm_max, best)
            if accepted:
                return _AMBIGUOUS if accepted > 1 else _IDENTIFIED, tested[0], best
            if time_is_up(clock, cost + _PREDICTION_COST * len(image)
                          + count * (TRIANGLE_COST + _VERIFICATION_COST * len(image))):
                return _TIME_LIMIT, tested[0], best
    return _EXHAUSTED, tested[0], best


@compiled
def _is_searched(verifier: VerifierData, sigma: np.ndarray, count: int, looked_up: int,
                 tested: int, false_alarm_max: float) -> bool:
    """
    Return whether more triangles of count image stars are of no use.

    Of the N = C(count, 3) triangles K = C(m, 3) are of true stars alone if m stars are true. When
    a share t of all was looked up, the field is not found with a probability of (1 - t q)^K.
    """
    r = verifier.tolerance_sigmas * upper_median(sigma)
    poor = max(verifier.counts[len(verifier.counts) // _POOREST], 1)
    p = min(1.0, poor * np.pi * r ** 2 / verifier.area)
    m = least_matches(count, p, 1 / _POOREST, 3, verifier.tolerance_sigmas, tested,
                      false_alarm_max)
    if m > count:
        return True
    share = looked_up / (count * (count - 1) * (count - 2) / 6)
    return (m * (m - 1) * (m - 2) / 6 * np.log(1 - min(share, 1.0) * _FINDS) < np.log(_MISSED))


@compiled
def _verify_all(verifier: VerifierData, seen: np.ndarray, sigma: np.ndarray, base: np.ndarray,
                candidates: np.ndarray, tested: int, false_alarm_max: float, best: Verification
                ) -> tuple[int, Verification]:
    """
    Verify the candidates (M, 3) of a triangle base (3,).

    Return how many accepted ones have attitudes of their own, and the best verification so far.
    """
    accepted = 0
    for row in range(len(candidates)):
        verification = verify(verifier, seen, sigma, base, candidates[row], tested)
        if verification.false_alarm <= false_alarm_max and (
                not accepted or not same_attitude(verification.star, best.star)):
            accepted += 1
        if verification.false_alarm < best.false_alarm:
            best = verification
    return accepted, best
