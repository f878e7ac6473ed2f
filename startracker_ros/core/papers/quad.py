# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Quads of bright stars through the k-vector, confirmed by triangles over the whole field.

Yuan, Zhang, Shi 2017, star identification by k-vector and quadrilaterals. Differences
from the paper: sides are compared as angles, not as cosines, which lose the short ones;
tolerances follow from the errors of the centroids, where the paper's 1e-6 of a cosine is
1 arcsec at 10 deg and so for images without noise; handedness is checked
at once.
"""

from collections.abc import Iterator
from copy import copy
from functools import lru_cache, partial
from itertools import combinations

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.cache import cached_pairs
from startracker_ros.core.identify.identification import (
    CandidateIdentifier, Candidates, FieldStars, Identification, IdentificationOptions)
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.identify.verification import MAX_VERIFIED, Verifier
from startracker_ros.core.maths.rotation import angle_between, rotate

# The relative noise of shorter sides is too large to be of use.
_MIN_SEPARATION_PX = 20.0
# Quads are made of so many of the brightest stars: 4845 of them.
_QUAD_STARS = 20
# Ratio of the trust in a star and in the next brighter one.
_FAINTER_TRUST = 0.9
# A quad that fits so many catalogue quads is not evidence and is skipped to save time.
_MAX_QUADS = 1000
_MAX_JOINED = 500_000
# Radius of a predicted field over that of the image: the image may have moved by a tenth of it.
_PREDICTED_FIELD = 1.1
_SIDES = tuple(combinations(range(4), 2))
_TRIPLES = np.array(list(combinations(range(4), 3)))


class QuadIdentifier(CandidateIdentifier):
    """Quads of bright stars, looked up side by side, confirmed by triangles with all others."""

    # Four of the base and one that confirms it.
    min_stars = 5

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        self.verifier: QuadVerifier = QuadVerifier(camera, self.onboard, options.tolerance_sigmas,
                                                   self.scale_error)
        self.pairs: PairDatabase | FieldPairs = cached_pairs(
            self.onboard, _MIN_SEPARATION_PX * camera.pixel_rad,
            2 * camera.corner_angle_rad * (1 + self.scale_error))

    def identify_near(self, centroids: Centroids, quaternion: np.ndarray) -> Identification:
        """
        Return which stars the centroids are, near an attitude (4,).

        That is the tracking mode of the paper, in which the frame before predicts it. Quads are
        searched among the stars of the field about it; where that identifies nothing, among
        those of the whole sky.
        """
        near = self.onboard.within(rotate(quaternion, [0.0, 0.0, 1.0]),
                                   _PREDICTED_FIELD * self.camera.corner_angle_rad)
        near = near[~self.onboard.crowded[near]]
        tracking = copy(self)
        tracking.pairs = FieldPairs(near, self.onboard.direction[near])
        found = tracking.identify(centroids)
        return found if found.attitude is not None else self.identify(centroids)

    def candidates(self, field: FieldStars) -> Iterator[Candidates]:
        """Yield the catalogue quads that fit one image quad after the other."""
        for base in base_quads(len(field)):
            quads = matching_quads(self.pairs, self.pairs.direction, field.direction[base],
                                   field.sigma_rad[base], self.options.tolerance_sigmas,
                                   self.scale_error)
            yield Candidates(base, self.pairs.star[quads])


class FieldPairs:
    """All pairs of the stars of one predicted field, by separation, as PairDatabase has them."""

    def __init__(self, star: np.ndarray, direction: np.ndarray) -> None:
        """Sort the pairs of stars (S,), catalogue indices, with their unit vectors (S, 3)."""
        self.star, self.direction = star, direction
        first, second = np.triu_indices(len(star), 1)
        separation = angle_between(direction[first], direction[second])
        order = np.argsort(separation)
        self.separation, self._pairs = separation[order], np.stack([first, second])[:, order]

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs of a separation in both orders: stars a (M,) and b (M,)."""
        found = slice(*np.searchsorted(self.separation, [low_rad, high_rad]))
        first, second = self._pairs[:, found]
        return np.concatenate([first, second]), np.concatenate([second, first])


class QuadVerifier(Verifier):
    """Verifies the quads that the field match of the paper confirms."""

    def __init__(self, camera: Camera, onboard: OnboardCatalog, tolerance_sigmas: float,
                 scale_error: float) -> None:
        super().__init__(camera, onboard, tolerance_sigmas, scale_error)
        # Allows for the error of the boresight from four stars.
        self.field_match = partial(full_field_match, onboard, 1.05 * camera.corner_angle_rad,
                                   tolerance_sigmas, scale_error)

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """
        Return the candidates (K,) in which stars beyond the quad match, the best first.

        image (N, 3) are the image stars, base (4,) those of the quad, stars (M, 4) the
        catalogue stars that they may be.
        """
        matched = np.array([np.count_nonzero(self.field_match(image, sigma_rad, base, star) >= 0)
                            for star in stars], int)
        best = np.argsort(-matched, kind='stable')[:MAX_VERIFIED]
        return best[matched[best] > len(base)]


def base_quads(count: int) -> Iterator[np.ndarray]:
    """
    Yield index quadruples (4,) of count image stars until none is left.

    The next one has the greatest product of trusts, w_i = 0.9^i for the i-th brightest. Each
    quad halves the trust in its stars, so that a false star is soon left.
    """
    count = min(count, _QUAD_STARS)
    quads = _combinations(count)
    trust = _FAINTER_TRUST ** np.arange(count)
    untried = np.ones(len(quads))
    for _ in quads:
        chosen = np.argmax(trust[quads].prod(1) * untried)
        yield quads[chosen]
        untried[chosen] = 0.0
        trust[quads[chosen]] /= 2


@lru_cache
def _combinations(count: int) -> np.ndarray:
    return np.array(list(combinations(range(count), 4)))


def matching_quads(pairs: PairDatabase | FieldPairs, directions: np.ndarray, image: np.ndarray,
                   sigma_rad: np.ndarray, tolerance_sigmas: float,
                   scale_error: float) -> np.ndarray:
    """
    Return catalogue quadruples (M, 4) that fit four image stars.

    directions (S, 3) are those of the stars of the pairs, image (4, 3)
    unit vectors of the image stars, sigma_rad (4,) their errors per axis. A quadruple fits
    when each of its six sides agrees with that of the image within tolerance_sigmas of the
    noise and scale_error, and when its handedness agrees. None are returned where more than
    _MAX_QUADS fit.
    """
    side = {}
    for i, j in _SIDES:
        angle = angle_between(image[i], image[j])
        reach = tolerance_sigmas * np.hypot(sigma_rad[i], sigma_rad[j]) + scale_error * angle
        side[i, j] = pairs.between(angle - reach, angle + reach)
    # The identifier array of the paper: how many of the three sides in a row a star has.
    level = np.zeros(len(directions), np.int8)
    for other in (1, 2, 3):
        star = side[0, other][0]
        level[star[level[star] == other - 1]] = other
    # A star may have several partners on one side. The paper stores one, here all are used.
    quads = np.flatnonzero(level == 3)[:, None]
    for other in (1, 2, 3):
        star, partner = side[0, other]
        whole = level[star] == 3
        quads = _join(quads, star[whole], partner[whole])
        for known in range(1, other):
            quads = quads[_among(quads[:, [known, other]], *side[known, other], len(directions))]
    triple = _TRIPLES[np.argmax(abs(np.linalg.det(image[_TRIPLES])))]
    handedness = np.sign(np.linalg.det(image[triple]))
    quads = quads[np.sign(np.linalg.det(directions[quads[:, triple]])) == handedness]
    return quads if len(quads) <= _MAX_QUADS else quads[:0]


def _join(rows: np.ndarray, star: np.ndarray, partner: np.ndarray) -> np.ndarray:
    """
    Return rows (M, K + 1): each of rows (M, K) with each partner of its first star.

    None are returned where they would be more than _MAX_JOINED.
    """
    order = np.argsort(star, kind='stable')
    begin, end = (np.searchsorted(star[order], rows[:, 0], which) for which in ('left', 'right'))
    count = end - begin
    if count.sum() > _MAX_JOINED:
        return np.empty((0, rows.shape[1] + 1), int)
    row = np.repeat(np.arange(len(rows)), count)
    within = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return np.column_stack([rows[row], partner[order[begin[row] + within]]])


def _among(two: np.ndarray, a: np.ndarray, b: np.ndarray, size: int) -> np.ndarray:
    """Return which rows of two (M, 2) are among the pairs a (P,), b (P,) of stars below size."""
    listed = np.sort(size * a.astype(int) + b)
    wanted = two @ [size, 1]
    return np.searchsorted(listed, wanted, 'right') > np.searchsorted(listed, wanted, 'left')


def full_field_match(onboard: OnboardCatalog, radius_rad: float, tolerance_sigmas: float,
                     scale_error: float, image: np.ndarray, sigma_rad: np.ndarray,
                     base: np.ndarray, star: np.ndarray) -> np.ndarray:
    """
    Return the catalogue star (N,) of each image star (N, 3), -1 where none matches.

    Image stars base (B,) are assumed to be the catalogue stars star (B,); the catalogue is cut
    to radius_rad about the boresight of their attitude. Any other star matches when its
    triangles with all pairs of base stars do. Pairs of base stars agree already, so its B
    sides to them are compared: within tolerance_sigmas of the noise sigma_rad (N,) and
    scale_error.
    """
    corner = onboard.direction[star]
    # Markley 1988: the rotation of Wahba's problem by the SVD, here with equal weights.
    left, _, right = np.linalg.svd(corner.T @ image[base])
    coarse = left * [1.0, 1.0, np.linalg.det(left @ right)] @ right
    near = onboard.within(coarse[:, 2], radius_rad)
    seen = angle_between(image[:, None], image[base])
    true = angle_between(onboard.direction[near][:, None], corner)
    reach = (tolerance_sigmas * np.hypot(sigma_rad[:, None], sigma_rad[base])
             + scale_error * seen)
    worst = np.max(np.abs(seen[:, None] - true) / reach[:, None], axis=2)
    nearest, row = worst.argmin(1), np.arange(len(image))
    # One to one: of several image stars at one catalogue star the nearest matches.
    good = (worst[row, nearest] <= 1) & (worst.argmin(0)[nearest] == row)
    found = np.where(good, near[nearest], -1)
    found[base] = star
    return found
