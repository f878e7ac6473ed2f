# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The brightest spots of an image, with a quota for each part of it."""

import numpy as np

CELLS = 8  # along each side of the image,
CELL_SHARE = 4.0  # each of which gets so many times its share of the spots


def brightest(uv: np.ndarray, shape: tuple[int, ...], most: int,
              cell_share: float = CELL_SHARE) -> np.ndarray:
    """
    Return the indices of the first `most` positions uv (K, 2), with a quota for each cell.

    No cell of the image gets more than cell_share times its share while others have any.
    """
    if len(uv) <= most:
        return np.arange(len(uv))
    cell = (np.floor(uv / [shape[1], shape[0]] * CELLS) @ [1, CELLS]).astype(int)
    order = np.argsort(cell, kind='stable')
    first = np.searchsorted(cell[order], cell[order])
    rank = np.empty(len(uv), int)
    rank[order] = np.arange(len(uv)) - first
    beyond = rank >= np.ceil(cell_share * most / CELLS ** 2)
    return np.sort(np.argsort(beyond, kind='stable')[:most])
