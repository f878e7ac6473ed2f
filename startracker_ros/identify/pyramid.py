"""Triangles of image stars among the catalogue pairs, in the order of the Pyramid algorithm.

Mortari, Samaan, Bruccoleri, Junkins, The Pyramid Star Identification Technique,
Navigation 51 (2004).
"""

from collections.abc import Iterator

import numpy as np

from startracker_ros.identify.pairs import PairDatabase

# A triangle flatter than this many sigmas of its own height has no sure handedness.
_FLAT_SIGMAS = 4.0


def triads(count: int) -> Iterator[tuple[int, int, int]]:
    """Yield index triples so that no star stays in many of them one after another.

    A false star then spoils a few triples only (Mortari et al. 2004, figure 5).
    """
    for near in range(1, count - 1):
        for far in range(1, count - near):
            for first in range(count - near - far):
                yield first, first + near, first + near + far


def matching_triangles(pairs: PairDatabase, directions: np.ndarray, image: np.ndarray,
                       sigma_rad: np.ndarray, tolerance_sigmas: float,
                       scale_error: float) -> np.ndarray:
    """Return catalogue triples (M, 3) that fit three image stars.

    directions (S, 3) are those of the catalogue stars that the pairs count, image (3, 3)
    unit vectors of the image stars, sigma_rad (3,) their errors per axis. A triple fits
    when its three sides agree with those of the image within tolerance_sigmas of the
    noise, after one common scale within 1 +- scale_error, and when its handedness agrees.
    """
    sides = ((0, 1), (0, 2), (1, 2))
    angle = np.array([_angle(image[i], image[j]) for i, j in sides])
    noise = tolerance_sigmas * np.array([np.hypot(sigma_rad[i], sigma_rad[j]) for i, j in sides])
    reach = noise + scale_error * angle
    size = len(directions)
    found = [pairs.between(angle[k] - reach[k], angle[k] + reach[k]) for k in range(3)]
    (a, b), (a2, c2), (b3, c3) = _common(found, size)
    order = np.argsort(a2)
    ranked = a2[order]
    begin = np.searchsorted(ranked, a, 'left')
    repeat = np.searchsorted(ranked, a, 'right') - begin
    row = np.repeat(np.arange(len(a)), repeat)
    within = np.arange(len(row)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    c = c2[order[begin[row] + within]]
    known = np.sort(b3.astype(np.int64) * size + c3)
    if not len(known):
        return np.empty((0, 3), int)
    key = b[row].astype(np.int64) * size + c
    place = np.minimum(np.searchsorted(known, key), len(known) - 1)
    closed = known[place] == key
    triples = np.stack([a[row], b[row], c], -1)[closed]
    return triples[_fits(directions[triples], image, angle, noise)]


def _common(found: list[tuple[np.ndarray, np.ndarray]], size: int
            ) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the sides ab, ac, bc without those whose ends no other side has."""
    (a, b), (a2, c2), (b3, c3) = found
    in_ab, in_ac, in_bc = (np.zeros((2, size), bool) for _ in range(3))
    in_ab[0, a], in_ab[1, b], in_ac[0, a2], in_ac[1, c2] = True, True, True, True
    in_bc[0, b3], in_bc[1, c3] = True, True
    ab = in_ac[0, a] & in_bc[0, b]
    ac = in_ab[0, a2] & in_bc[1, c2]
    bc = in_ab[1, b3] & in_ac[1, c3]
    return [(a[ab], b[ab]), (a2[ac], c2[ac]), (b3[bc], c3[bc])]


def _fits(corner: np.ndarray, image: np.ndarray, angle: np.ndarray,
          noise: np.ndarray) -> np.ndarray:
    """Return which triangles (M, 3, 3) have the sides, up to scale, and the hand of the image."""
    chord = np.stack([np.linalg.norm(corner[:, i] - corner[:, j], axis=1)
                      for i, j in ((0, 1), (0, 2), (1, 2))], -1)
    side = 2 * np.arcsin(chord / 2)
    weight = 1 / noise ** 2
    scale = (side * angle * weight).sum(1) / (angle ** 2 * weight).sum()
    alike = np.all(np.abs(side - scale[:, None] * angle) <= noise, axis=1)
    volume = np.linalg.det(image)
    flat = abs(volume) < noise.max() / 3.5 * _FLAT_SIGMAS * angle.max()
    same_hand = np.sign(np.linalg.det(corner)) == np.sign(volume)
    return alike & (same_hand | flat)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return 2 * np.arcsin(min(np.linalg.norm(a - b) / 2, 1.0))
