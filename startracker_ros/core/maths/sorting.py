# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scatter of sorted values; connected nodes of a graph."""

import numpy as np

SIGMA_PER_MAD = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""


def lowest_connected(pairs: np.ndarray, size: int) -> np.ndarray:
    """Return for each node (size,) of the graph of pairs (P, 2) the lowest one it connects to."""
    lowest = np.arange(size)
    while (lowest[pairs[:, 0]] != lowest[pairs[:, 1]]).any():
        # Propagate the lowest index over the edges, then shorten the paths to it.
        np.minimum.at(lowest, pairs, lowest[pairs].min(axis=1, keepdims=True))
        lowest = lowest[lowest]
    return lowest
