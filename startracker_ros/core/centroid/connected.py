# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Connected pixels of an image, of which few are above the threshold."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def connected_spots(u: np.ndarray, v: np.ndarray, width: int, height: int
                    ) -> tuple[np.ndarray, int]:
    """
    Return the number (N,) of the spot of each of the pixels u, v (N,), and how many there are.

    The pixels are in the order of the image, (width, height) px. Those that touch, by a side or a
    corner, are one spot. Union of sets with halved paths (Tarjan 1975).
    """
    parent = np.arange(len(u))
    # One more than the pixel that is there, 0 for none.
    seen = np.zeros((height + 1, width + 2), np.int32)
    for i in range(len(u)):
        row, column = v[i] + 1, u[i] + 1
        for r, c in ((row, column - 1), (row - 1, column - 1), (row - 1, column),
                     (row - 1, column + 1)):
            if seen[r, c]:
                one, other = _first(parent, i), _first(parent, seen[r, c] - 1)
                parent[max(one, other)] = min(one, other)
        seen[row, column] = i + 1
    spot, count = np.empty(len(u), np.int64), 0
    for i in range(len(u)):
        if parent[i] == i:
            spot[i] = count
            count += 1
        else:
            spot[i] = spot[_first(parent, i)]
    return spot, count


@compiled
def _first(parent: np.ndarray, i: int) -> int:
    """Return the first pixel of the set of pixel i."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
