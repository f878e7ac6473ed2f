"""
What chance would do: the statistical model of the false-alarm probability.

A candidate comes from three stars, or b. Were it wrong, each of the
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

The chances together, as Fisher (1925) combines them, times the number of candidates
that were tested, are the false-alarm probability.
"""

import numpy as np
from startracker_ros.compiled import compiled

# Matched stars whose order is looked at.
_ORDERED = 12
# Cells along one side of a square image: 3/4 of a degree in a field of 12.
_CELLS = 16


@compiled
def cells(seen: np.ndarray, matched: np.ndarray, area: float) -> tuple[int, np.ndarray]:
    """
    Return how many cells of an image hold its stars (N, 2), and the first matched (N,).

    The latter are True for the brightest matched star of each cell. area is that of the image.
    """
    edge = np.sqrt(area) / _CELLS
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
def up_to(values: np.ndarray, limit: int) -> int:
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
def binomial_tail(least: int, trials: int, chance: float) -> float:
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
def order_chance(star: np.ndarray, chosen: np.ndarray) -> float:
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
def distance_chance(distance: np.ndarray, radius: float, base: int) -> float:
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
def combined(product: float) -> float:
    """Return the probability that the product of three uniform numbers is so small."""
    log = -np.log(product) if product > 0 else 0.0
    return product * (1 + log + log * log / 2)
