"""
Whether further image stars support a candidate: a quick look before it is judged.

Three image stars that are taken for three catalogue stars predict where others must be.
"""

import numpy as np
from startracker_ros.catalog.sky_grid import nearest, SkyGrid
from startracker_ros.compiled import compiled, inlined

# Image stars that are looked up for each candidate.
_SUPPORTERS = 8


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
    for _ in range(min(_SUPPORTERS, count)):
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
def support(sky: SkyGrid, weights: np.ndarray, reach: np.ndarray, first: int, second: int,
            third: int) -> int:
    """Return how many predicted image stars are at a catalogue star, if three are these stars."""
    a, b, c = sky.direction[first], sky.direction[second], sky.direction[third]
    count = 0
    for i in range(len(reach)):
        x = weights[i, 0] * a[0] + weights[i, 1] * b[0] + weights[i, 2] * c[0]
        y = weights[i, 0] * a[1] + weights[i, 1] * b[1] + weights[i, 2] * c[1]
        z = weights[i, 0] * a[2] + weights[i, 1] * b[2] + weights[i, 2] * c[2]
        length = np.sqrt(x * x + y * y + z * z)
        count += nearest(sky, x / length, y / length, z / length, reach[i])[0] >= 0
    return count
