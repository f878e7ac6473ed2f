# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Support of further image stars for a candidate triangle, for compiled searches.

As native/src/identify/support.h, for stars of any precision, without the order of brightness.

Image stars a, b, c taken for catalogue stars A, B, C predict where star i must be. With

    i = w_a a + w_b b + w_c c,    w_a = i . (b x c) / a . (b x c) and so on,

the catalogue direction is that of w_a A + w_b B + w_c C. This needs no attitude, and a wrong
focal length cancels. The error of the prediction and of the star itself is

    sigma^2 = sigma_i^2 + w_a^2 sigma_a^2 + w_b^2 sigma_b^2 + w_c^2 sigma_c^2.

One of the N catalogue stars is within its tolerance r by chance with p = N r^2 / 4. A star that
is there supports the candidate by -ln p: the logarithm of how much more likely it makes it.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.catalog.sky_grid import nearest, SkyGrid
from startracker_ros.core.compiled import compiled, inlined

# Image stars that are looked up for each candidate.
_SUPPORTERS = 16


class Supporters(NamedTuple):
    """
    The image stars that base (3,) predicts best, those of most support first.

    weight (K, 3), reach (K,) in rad in which each is looked up, gain (K,) its support.
    """

    base: np.ndarray
    weight: np.ndarray
    reach: np.ndarray
    gain: np.ndarray


@compiled
def supporters(sky: SkyGrid, image: np.ndarray, sigma: np.ndarray, base: np.ndarray,
               tolerance_sigmas: float) -> Supporters:
    """
    Return the stars that base (3,) predicts best.

    image (N, 3) are unit vectors, sigma (N,) their errors in rad.
    """
    a, b, c = base[0], base[1], base[2]
    whole = triple_product(image, a, b, c)
    # Rows b x c, c x a, a x b over a . (b x c): their products with star i are its weights.
    dual = np.empty((3, 3))
    for k in range(3):
        p, q = base[(k + 1) % 3], base[(k + 2) % 3]
        dual[k, 0] = (image[p, 1] * image[q, 2] - image[p, 2] * image[q, 1]) / whole
        dual[k, 1] = (image[p, 2] * image[q, 0] - image[p, 0] * image[q, 2]) / whole
        dual[k, 2] = (image[p, 0] * image[q, 1] - image[p, 1] * image[q, 0]) / whole
    variance_a, variance_b, variance_c = sigma[a] ** 2, sigma[b] ** 2, sigma[c] ** 2
    weight, reach = np.empty((_SUPPORTERS, 3)), np.empty(_SUPPORTERS)
    # Beyond, a star is there by chance.
    farthest = 2 / np.sqrt(len(sky.direction))
    chosen = 0
    for i in range(len(image)):
        if i in (a, b, c):
            continue
        x, y, z = image[i, 0], image[i, 1], image[i, 2]
        w_a = x * dual[0, 0] + y * dual[0, 1] + z * dual[0, 2]
        w_b = x * dual[1, 0] + y * dual[1, 1] + z * dual[1, 2]
        w_c = x * dual[2, 0] + y * dual[2, 1] + z * dual[2, 2]
        radius = tolerance_sigmas * np.sqrt(sigma[i] ** 2 + w_a * w_a * variance_a
                                            + w_b * w_b * variance_b + w_c * w_c * variance_c)
        if not radius < (farthest if chosen < _SUPPORTERS else reach[-1]):
            continue
        row = min(chosen, _SUPPORTERS - 1)
        while row > 0 and reach[row - 1] > radius:
            reach[row] = reach[row - 1]
            for k in range(3):
                weight[row, k] = weight[row - 1, k]
            row -= 1
        reach[row], weight[row, 0], weight[row, 1], weight[row, 2] = radius, w_a, w_b, w_c
        chosen = min(chosen + 1, _SUPPORTERS)
    return Supporters(base, weight[:chosen], reach[:chosen], 2 * np.log(farthest / reach[:chosen]))


@inlined
def squared_chord(direction: np.ndarray, a: int, b: int) -> float:
    """Return the squared chord between two of the unit vectors (N, 3)."""
    x, y = direction[a, 0] - direction[b, 0], direction[a, 1] - direction[b, 1]
    z = direction[a, 2] - direction[b, 2]
    return x * x + y * y + z * z


@compiled
def triple_product(vectors: np.ndarray, a: int, b: int, c: int) -> float:
    """Return a . (b x c) of three of the vectors (N, 3)."""
    # Scalars alone: a view of a row costs more than the arithmetic with it.
    x, y, z = vectors[a, 0], vectors[a, 1], vectors[a, 2]
    return (x * (vectors[b, 1] * vectors[c, 2] - vectors[b, 2] * vectors[c, 1])
            + y * (vectors[b, 2] * vectors[c, 0] - vectors[b, 0] * vectors[c, 2])
            + z * (vectors[b, 0] * vectors[c, 1] - vectors[b, 1] * vectors[c, 0]))


@inlined
def support_of_places(sky: SkyGrid, stars: Supporters, first: int, second: int, third: int,
                      enough: float) -> float:
    """
    Return the support of the other stars for a candidate: base is these three catalogue stars.

    A sum that can no longer exceed enough is not completed.
    """
    direction, weight, reach, gain = sky.direction, stars.weight, stars.reach, stars.gain
    ax, ay, az = direction[first, 0], direction[first, 1], direction[first, 2]
    bx, by, bz = direction[second, 0], direction[second, 1], direction[second, 2]
    cx, cy, cz = direction[third, 0], direction[third, 1], direction[third, 2]
    found, left = 0.0, gain.sum()
    for i in range(len(reach)):
        if found + left <= enough:
            break
        left -= gain[i]
        x = weight[i, 0] * ax + weight[i, 1] * bx + weight[i, 2] * cx
        y = weight[i, 0] * ay + weight[i, 1] * by + weight[i, 2] * cy
        z = weight[i, 0] * az + weight[i, 1] * bz + weight[i, 2] * cz
        unit = 1 / np.sqrt(x * x + y * y + z * z)
        if nearest(sky, unit * x, unit * y, unit * z, reach[i])[0] >= 0:
            found += gain[i]
    return found
