"""Triangles of image stars among the catalogue pairs, in the order of the Pyramid algorithm.

Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique,
Navigation 51 (2004).
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations

import numpy as np

from startracker_ros.camera import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.identify.cache import cached_pairs
from startracker_ros.identify.identification import (
    Candidates, FieldStars, IdentificationOptions, StarIdentifier)
from startracker_ros.identify.pairs import PairDatabase

# Sides of a triangle shorter than this say little beside their noise.
_MIN_SEPARATION_PX = 20.0

# A triangle flatter than this many sigmas of its own height has no sure handedness.
_FLAT_SIGMAS = 4.0
_SIDES = ((0, 1), (0, 2), (1, 2))
# Triples are made of so many of the brightest stars: 1140 of them.
_TRIAD_STARS = 20
# Trust in a star relative to the next brighter one: nine of ten, a start without evidence.
_FAINTER_TRUST = 0.9
# What a triple costs in any case, in joined pairs.
_TRIAD_COST = 2000.0


class PyramidIdentifier(StarIdentifier):
    """Triangles of image stars, looked up side by side, confirmed by all other stars."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        super().__init__(camera, epoch_year, options, catalog)
        self._pairs = cached_pairs(self.places, _MIN_SEPARATION_PX * camera.pixel_rad,
                                   2 * camera.corner_angle_rad * (1 + self.scale_error))
        self._directions = self.places.direction[self._pairs.star]

    def candidates(self, field: FieldStars) -> Iterator[Candidates]:
        """Yield the catalogue triangles that fit one image triangle after the other."""
        sigmas = self.options.tolerance_sigmas
        for base in triads(self._pairs, field.direction, field.sigma_rad, sigmas,
                           self.scale_error):
            triangles = matching_triangles(
                self._pairs, self._directions, field.direction[base], field.sigma_rad[base],
                sigmas, self.scale_error)
            yield Candidates(base, self._pairs.star[triangles])


def triads(pairs: PairDatabase, image: np.ndarray, sigma_rad: np.ndarray,
           tolerance_sigmas: float, scale_error: float) -> Iterator[np.ndarray]:
    """Yield index triples (3,) of image stars (N, 3), brightest first, until all were tried.

    The next one has the most trust for its cost. Trust starts a little higher for bright
    stars and halves for the three stars of each triple that is asked to be followed by
    another, so that a false star is soon left aside (the aim of the order of Mortari et
    al. 2004, figure 5); the cost is that of joining the pairs of the two shorter sides.
    """
    count = min(len(image), _TRIAD_STARS)
    triple = _combinations(count)
    i, j = np.triu_indices(count, 1)
    angle = _angle(image[i], image[j])
    reach = tolerance_sigmas * np.hypot(sigma_rad[i], sigma_rad[j]) + scale_error * angle
    found = np.zeros((count, count))
    found[i, j] = pairs.count(angle - reach, angle + reach)
    sides = np.sort(found[triple[:, [0, 0, 1]], triple[:, [1, 2, 2]]], axis=1)
    cost = _TRIAD_COST + sides[:, 0] * sides[:, 1] / max(len(pairs.star), 1)
    trust = _FAINTER_TRUST ** np.arange(count)
    # A side that no pair has closes no triangle.
    value = np.where(sides[:, 0] > 0, 1 / cost, 0.0)
    for _ in range(np.count_nonzero(value)):
        chosen = np.argmax(trust[triple].prod(1) * value)
        yield triple[chosen]
        value[chosen] = 0.0
        trust[triple[chosen]] /= 2


@lru_cache
def _combinations(count: int) -> np.ndarray:
    return np.array(list(combinations(range(count), 3)))


def matching_triangles(pairs: PairDatabase, directions: np.ndarray, image: np.ndarray,
                       sigma_rad: np.ndarray, tolerance_sigmas: float,
                       scale_error: float) -> np.ndarray:
    """Return catalogue triples (M, 3) that fit three image stars.

    directions (S, 3) are those of the catalogue stars that the pairs count, image (3, 3)
    unit vectors of the image stars, sigma_rad (3,) their errors per axis. A triple fits
    when its three sides agree with those of the image within tolerance_sigmas of the
    noise, after one common scale within 1 +- scale_error, and when its handedness agrees.
    """
    angle = np.array([_angle(image[i], image[j]) for i, j in _SIDES])
    noise = tolerance_sigmas * np.array([np.hypot(sigma_rad[i], sigma_rad[j]) for i, j in _SIDES])
    reach = noise + scale_error * angle
    # The two shorter sides have the fewest pairs; they are joined where they meet, and the
    # longest side of what they span is measured.
    longest = int(np.argmax(angle))
    end, other_end = _SIDES[longest]
    meet = 3 - end - other_end
    side, other_side = _side(meet, end), _side(meet, other_end)
    a, b = pairs.between(angle[side] - reach[side], angle[side] + reach[side])
    a2, c = pairs.between(angle[other_side] - reach[other_side],
                          angle[other_side] + reach[other_side])
    row, row2 = _join(a, a2, len(directions))
    b, c = b[row], c[row2]
    difference = directions[b] - directions[c]
    square = np.einsum('ij,ij->i', difference, difference)
    low, high = (2 * np.sin(np.clip(angle[longest] + sign * reach[longest], 0, np.pi) / 2)
                 for sign in (-1, 1))
    closed = np.flatnonzero((square >= low ** 2) & (square <= high ** 2))
    triples = np.empty((len(closed), 3), int)
    triples[:, meet] = a[row[closed]]
    triples[:, end] = b[closed]
    triples[:, other_end] = c[closed]
    return triples[_fits(directions[triples], image, angle, noise)]


def _side(corner: int, other: int) -> int:
    return _SIDES.index((min(corner, other), max(corner, other)))


def _join(left: np.ndarray, right: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (M,), (M,) of all equal elements of two lists of numbers below size."""
    # NumPy sorts 16 bit integers by radix, several times faster than wider ones.
    order = np.argsort(right.astype(np.uint16) if size <= 2 ** 16 else right, kind='stable')
    count = np.bincount(right, minlength=size)
    begin = np.cumsum(count) - count
    repeat = count[left]
    row = np.repeat(np.arange(len(left)), repeat)
    within = np.arange(len(row)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    return row, order[begin[left[row]] + within]


def _fits(corner: np.ndarray, image: np.ndarray, angle: np.ndarray,
          noise: np.ndarray) -> np.ndarray:
    """Return which triangles (M, 3, 3) have the sides, up to scale, and the hand of the image."""
    chord = np.stack([np.linalg.norm(corner[:, i] - corner[:, j], axis=1)
                      for i, j in _SIDES], -1)
    side = 2 * np.arcsin(chord / 2)
    weight = 1 / noise ** 2
    scale = (side * angle * weight).sum(1) / (angle ** 2 * weight).sum()
    alike = np.all(np.abs(side - scale[:, None] * angle) <= noise, axis=1)
    volume = np.linalg.det(image)
    flat = abs(volume) < noise.max() / 3.5 * _FLAT_SIGMAS * angle.max()
    same_hand = np.sign(np.linalg.det(corner)) == np.sign(volume)
    return alike & (same_hand | flat)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (...) between unit vectors (..., 3)."""
    return 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=-1) / 2, 1.0))
