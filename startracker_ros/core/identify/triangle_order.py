# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The order in which triangles of image stars are looked up.

Mortari et al. (2004, figure 5) permute the three indices so that no star stays in many
triangles in a row: a false star then contaminates few of them. Here each star i has a weight w_i,
0.9^i for the i-th brightest of 40 or fewer, halved by each triangle that it was in. The next
triangle has the greatest

    w_i w_j w_k / C,    C = c_0 + c_1 (n_1 + n_2) + c_2 4 n_1 n_2 / (N B),

where C is the time it takes: n_1 and n_2 are the expected pairs of its two shorter sides, and
the last term is the size of their join (pair_search.py).
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.identify.pair_search import (
    band_count, expected_pairs, image_side, PairLevel)
from startracker_ros.core.maths.sorting import sort_indices

TRIANGLE_COST = 4000.0
"""c_0 in ns, also the time to verify one candidate."""
_PAIR_COST, _JOIN_COST, _SCAN_COST = 4.0, 8.0, 3.0
# Trust in each star over that in the next brighter one, of so many stars or fewer. Of more stars
# most are false, and brightness means less: the faintest is then trusted as the last of these.
_FAINTER_TRUST = 0.9
_BRIGHT = 40
# Triangles of the most trusted stars come first, then those of twice as many and so on.
_TRUSTED = 9


class SearchState(NamedTuple):
    """
    The n brightest stars of a frame during its search.

    weight (n,); ranked (n,) stars by weight; expected (n, n) catalogue pairs n_ij of a side, -1
    where not yet computed; used (n (n - 1) (n - 2) / 6,) bool by _triangle_number().
    """

    weight: np.ndarray
    ranked: np.ndarray
    expected: np.ndarray
    used: np.ndarray


@compiled
def new_state(count: int, most: int) -> SearchState:
    """Return the state before the first triangle of at most so many of count stars."""
    n = min(count, most)
    weight = np.empty(n)
    ratio = _FAINTER_TRUST ** min(_BRIGHT / max(n, 1), 1.0)
    for i in range(n):
        weight[i] = ratio ** i
    return SearchState(weight, np.arange(n), np.full((n, n), -1.0),
                       np.zeros(n * (n - 1) * (n - 2) // 6, np.bool_))


@inlined
def _triangle_number(i: int, j: int, k: int) -> int:
    """Return the number of a triangle in the order of its greatest, middle and least star."""
    least, greatest = min(i, j, k), max(i, j, k)
    middle = i + j + k - least - greatest
    return (greatest * (greatest - 1) * (greatest - 2) // 6 + middle * (middle - 1) // 2
            + least)


@compiled
def next_triangle(level: PairLevel, tolerance_sigmas: float, scale_error: float,
                  image: np.ndarray, sigma: np.ndarray, state: SearchState, base: np.ndarray
                  ) -> float:
    """
    Put the next triangle into base (3,) and return its cost in ns, negative when none is left.

    image (N, 3) are unit vectors, sigma (N,) their errors in rad. The longest side is that
    between the second and the third of base.
    """
    separation, stars, expected = level.table.values, len(level.star), state.expected
    ranked = state.ranked
    sort_indices(ranked, -state.weight)
    join_size = max(stars, 1) * band_count(scale_error)
    most, scanned = _TRUSTED, 0.0
    while True:
        most = min(most, len(ranked))
        for x in range(most):
            for y in range(x):
                i, j = ranked[x], ranked[y]
                if expected[i, j] < 0:
                    side = image_side(image, sigma, tolerance_sigmas, i, j)
                    expected[i, j] = expected[j, i] = expected_pairs(separation, stars, side,
                                                                     scale_error)
        cost = _best_triangle(state, ranked[:most], join_size, base)
        if cost >= 0:
            _use(state, base)
            return cost + scanned
        if most == len(ranked):
            return -1.0
        most *= 2
        scanned += _SCAN_COST * most ** 3 / 6


@compiled
def _best_triangle(state: SearchState, ranked: np.ndarray, join_size: int, base: np.ndarray
                   ) -> float:
    """Put the best unused triangle of the ranked stars into base (3,); return its cost or -1."""
    weight, n, used = state.weight, state.expected, state.used
    best, best_cost = 0.0, -1.0
    for x in range(len(ranked)):
        for y in range(x):
            i, j = ranked[x], ranked[y]
            n_ij = n[i, j]
            if not n_ij:
                continue
            for z in range(y):
                k = ranked[z]
                n_ik, n_jk = n[i, k], n[j, k]
                if not n_ik or not n_jk:
                    continue
                longest = max(n_ij, n_ik, n_jk)
                shorter = n_ij + n_ik + n_jk - longest
                join = 4.0 * n_ij * n_ik * n_jk / longest / join_size
                cost = TRIANGLE_COST + _PAIR_COST * shorter + _JOIN_COST * join
                value = weight[i] * weight[j] * weight[k] / cost
                if value > best and not used[_triangle_number(i, j, k)]:
                    best, best_cost = value, cost
                    base[0], base[1], base[2] = i, j, k
    return best_cost


@compiled
def _use(state: SearchState, base: np.ndarray) -> None:
    """Mark a triangle as used, halve the weight in its stars, put its longest side last."""
    n, used = state.expected, state.used
    i, j, k = base[0], base[1], base[2]
    used[_triangle_number(i, j, k)] = True
    for star in base:
        state.weight[star] /= 2
    if n[i, k] >= max(n[i, j], n[j, k]):
        base[0], base[1] = j, i
    elif n[i, j] >= max(n[i, k], n[j, k]):
        base[0], base[2] = k, i
