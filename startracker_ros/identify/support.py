"""
Whether further image stars support a candidate: a quick look before it is judged.

Three image stars that are taken for three catalogue stars predict where others must be.
"""

import numpy as np
from startracker_ros.catalog.sky_grid import nearest, SkyGrid
from startracker_ros.compiled import compiled

SUPPORTERS = 8
"""Image stars that are looked up for each candidate."""


@compiled
def support_weights(image: np.ndarray, sigma: np.ndarray, base: np.ndarray, tolerance_sigmas: float
                    ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how to predict other image stars from three: weights (K, 3), reach (K,) in rad.

    Written as a sum of the corners of the triangle a star needs no attitude to be
    predicted, and a wrong focal length cancels. The stars that the triangle predicts best
    are chosen.
    """
    a, b, c = base[0], base[1], base[2]
    whole = volume(image, a, b, c)
    count = len(image)
    weights = np.zeros((count, 3))
    reach = np.full(count, np.inf)
    for i in range(count):
        if i in (a, b, c):
            continue
        weights[i, 0] = volume(image, i, b, c) / whole
        weights[i, 1] = volume(image, a, i, c) / whole
        weights[i, 2] = volume(image, a, b, i) / whole
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


@compiled
def volume(vectors: np.ndarray, a: int, b: int, c: int) -> float:
    """Return the triple product a . (b x c) of three of the vectors (N, 3)."""
    # Scalars alone: a view of a row costs more than the arithmetic with it.
    x, y, z = vectors[a, 0], vectors[a, 1], vectors[a, 2]
    return (x * (vectors[b, 1] * vectors[c, 2] - vectors[b, 2] * vectors[c, 1])
            + y * (vectors[b, 2] * vectors[c, 0] - vectors[b, 0] * vectors[c, 2])
            + z * (vectors[b, 0] * vectors[c, 1] - vectors[b, 1] * vectors[c, 0]))


@compiled
def support(sky: SkyGrid, weights: np.ndarray, reach: np.ndarray, first: int, second: int,
            third: int, enough: int) -> int:
    """
    Return how many predicted image stars are at a catalogue star, if three are these stars.

    Where it cannot be more than enough, the rest is not looked up.
    """
    direction = sky.direction
    ax, ay, az = direction[first, 0], direction[first, 1], direction[first, 2]
    bx, by, bz = direction[second, 0], direction[second, 1], direction[second, 2]
    cx, cy, cz = direction[third, 0], direction[third, 1], direction[third, 2]
    count = 0
    for i in range(len(reach)):
        if count + len(reach) - i <= enough:
            break
        x = weights[i, 0] * ax + weights[i, 1] * bx + weights[i, 2] * cx
        y = weights[i, 0] * ay + weights[i, 1] * by + weights[i, 2] * cy
        z = weights[i, 0] * az + weights[i, 1] * bz + weights[i, 2] * cz
        unit = 1 / np.sqrt(x * x + y * y + z * z)
        count += nearest(sky, unit * x, unit * y, unit * z, reach[i])[0] >= 0
    return count
