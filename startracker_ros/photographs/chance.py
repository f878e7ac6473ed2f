# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How likely a wrong candidate agrees as well as this one, for compiled searches.

binomial_tail() is P_1 of native/src/identify/false_alarm.h, order_probability() P_3.

Few stars among many false spots leave such a product little, because it counts what a search has
tested, and all stars of the catalogue. How many wrong fields of the whole sky agree as well can be
said beforehand. Of n spots spread over an image of A = w h, m are matched with the sum X of their
squared residuals after attitude and focal length are fitted, and the faintest of them is the k-th
brightest catalogue star of the field. With the focal length known to a share e there are by chance

    E = C(n, m) k! / (k - m)!  4 pi / A  4 pi e  m (m - 1) (w^2 + h^2) / (12 A)
        (pi X / A)^(m - 2) / (m - 2)!

such fields: the ways to choose the spots and the stars, the independent fields of the sky, the
volume of turn and scale, that of the similarity transforms of m points, and that of a ball of
their 2 m - 4 residuals. E does not depend on how rich a field is, nor on how it was found. Any k
up to the S stars of the field, any order of brightness and any m may make it small, so that

    P_few = min(1, E P_3  sum_{j=m}^S m / j  (1 + ln m!)  2^(m - 4)),    m > 4,

each factor being what its choice adds to the expected number below a limit.
"""

import numpy as np
from startracker_ros.core.compiled import compiled

# Matched stars, the brightest, whose order is tested.
_ORDERED = 12

FEWEST = 5
"""Matches that P_few is for at least."""


@compiled
def occupied_cells(seen: np.ndarray, matched: np.ndarray, area: float, across: int
                   ) -> tuple[int, np.ndarray]:
    """
    Return how many cells of an image hold stars, and a mask (N,) of one match in each.

    seen (N, 2) are the stars in undistorted coordinates, brightest first; the mask is True for the
    brightest matched star of each cell. area is that of the image in
    rad^2, across how many cells are along the side of a square one.
    """
    edge = np.sqrt(area) / across
    count = len(seen)
    cell = np.empty((count, 2), np.int64)
    brightest = np.zeros(count, np.bool_)
    cells = 0
    for i in range(count):
        cell[i, 0], cell[i, 1] = np.floor(seen[i, 0] / edge), np.floor(seen[i, 1] / edge)
        new, brightest[i] = True, matched[i] >= 0
        for j in range(i):
            if cell[j, 0] == cell[i, 0] and cell[j, 1] == cell[i, 1]:
                new = False
                brightest[i] = brightest[i] and not brightest[j]
        cells += new
    return cells, brightest


@compiled
def binomial_tail(m: int, n: int, p: float) -> float:
    """Return P_1, the probability of m or more successes of n."""
    if m <= 0 or p >= 1:
        return 1.0
    # Relative to the largest term, which is near n p: far from it they are less than any number.
    largest = min(int((n + 1) * p), n)
    total = tail = 0.0
    term = 1.0
    for k in range(largest, n + 1):
        total += term
        tail += term if k >= m else 0.0
        term *= (n - k) / (k + 1) * p / (1 - p)
    term = 1.0
    for k in range(largest - 1, -1, -1):
        term *= (k + 1) / (n - k) * (1 - p) / p
        total += term
        tail += term if k >= m else 0.0
    return tail / total


def _permutation_shares() -> np.ndarray:
    """Return the share (n, k) of the permutations of n things with at most k inversions."""
    shares = np.ones((_ORDERED + 1, _ORDERED * (_ORDERED - 1) // 2 + 1))
    counts = np.ones(1)
    for n in range(2, _ORDERED + 1):
        # The n-th thing comes before 0 .. n - 1 of the others.
        counts = np.convolve(counts, np.ones(n)) / n
        shares[n, :len(counts)] = np.minimum(np.cumsum(counts), 1)
    return shares


_PERMUTATION_SHARES = _permutation_shares()


@compiled
def order_probability(star: np.ndarray, chosen: np.ndarray) -> float:
    """
    Return P_3 of the catalogue indices star (N,) of the image stars chosen (N,) bool.

    Both image stars and catalogue indices go from bright to faint.
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
    return _PERMUTATION_SHARES[count, inversions]


@compiled
def few_star_probability(n: int, m: int, k: int, stars: int, square: float, order: float,
                         size: tuple[float, float], scale_error: float) -> float:
    """
    Return P_few of m matches of n image stars, with k and S = stars catalogue stars.

    square is X, order P_3, size the width and the height of the image, in undistorted coordinates.
    """
    if m < FEWEST or k < m:
        return 1.0
    width, height = size
    area = width * height
    expected = (4 * np.pi / area * 4 * np.pi * scale_error
                * m * (m - 1) * (width ** 2 + height ** 2) / (12 * area))
    for i in range(m):
        expected *= (n - i) / (i + 1) * (k - i)
    for i in range(m - 2):
        expected *= np.pi * square / area / (i + 1)
    ranks, orders = 0.0, 1.0
    for i in range(m, max(k, stars) + 1):
        ranks += m / i
    for i in range(2, min(m, _ORDERED) + 1):
        orders += np.log(i)
    return min(1.0, expected * order * ranks * orders * 2.0 ** (m - FEWEST + 1))


@compiled
def fisher_combined(product: float) -> float:
    """Return the probability that four uniform numbers have a product of P or less."""
    log = -np.log(product) if product > 0 else 0.0
    return product * (1 + log + log * log / 2 + log * log * log / 6)
