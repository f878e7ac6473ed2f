# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Order and median of a few values, for compiled functions; connected nodes of a graph."""

import numpy as np
from startracker_ros.core.compiled import compiled

SIGMA_PER_MAD = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""


@compiled
def sort_indices(order: np.ndarray, values: np.ndarray) -> None:
    """
    Sort indices (M,) of values (N,) from the least to the greatest value, stable.

    Insertion sort: M (M - 1) / 4 moves on average, far fewer when nearly sorted. Up to some
    dozens of values it is faster than np.argsort. NaN values have no defined position.
    """
    for i in range(1, len(order)):
        moved = order[i]
        j = i
        while j > 0 and values[order[j - 1]] > values[moved]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = moved


@compiled
def insert_sorted(ordered: np.ndarray, count: int, value: float) -> None:
    """Insert a value into the first count values (N,), which ascend; N > count."""
    slot = count
    while slot > 0 and ordered[slot - 1] > value:
        ordered[slot] = ordered[slot - 1]
        slot -= 1
    ordered[slot] = value


@compiled
def upper_median(values: np.ndarray) -> float:
    """Return the median of a few values (N,), N > 0; of an even number the greater middle one."""
    ordered = np.empty_like(values)
    for k, value in enumerate(values):
        insert_sorted(ordered, k, value)
    return ordered[len(values) // 2]


def lowest_connected(pairs: np.ndarray, size: int) -> np.ndarray:
    """Return for each node (size,) of the graph of pairs (P, 2) the lowest one it connects to."""
    lowest = np.arange(size)
    while (lowest[pairs[:, 0]] != lowest[pairs[:, 1]]).any():
        # Propagate the lowest index over the edges, then shorten the paths to it.
        np.minimum.at(lowest, pairs, lowest[pairs].min(axis=1, keepdims=True))
        lowest = lowest[lowest]
    return lowest
