# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The matched filter of stars, row by row: the filtered image is never stored as a whole."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, fused


class Kernel(NamedTuple):
    """
    A Gaussian along rows and columns; weights (r + 1,) float32: its middle and one side, r even.

    noise_gain is the ratio of white noise after to before the filter. pairs is the share of the
    weights along a line that can be written as means of two neighbours.
    """

    weights: np.ndarray
    sigma_px: float
    noise_gain: float
    pairs: float


@lru_cache(maxsize=4)
def gaussian_kernel(sigma_px: float) -> Kernel:
    """
    Return the filter for stars of this PSF sigma.

    A Gaussian of the PSF sigma is the matched filter of stars;
    a sigma wrong by a factor q keeps 2 q / (1 + q^2) of the signal to noise ratio.
    """
    side = np.exp(-0.5 * (np.arange(np.ceil(2 * sigma_px) + 1) / sigma_px) ** 2)
    side /= 2 * side.sum() - side[0]
    weights = np.zeros(len(side) + 1 - len(side) % 2, np.float32)
    weights[:len(side)] = side
    return Kernel(weights, float(sigma_px), float(2 * (side ** 2).sum() - side[0] ** 2),
                  _share_of_pairs(weights))


def _share_of_pairs(weights: np.ndarray) -> float:
    """Return the share of the weights (r + 1,) that can be written as means of two neighbours."""
    rest, share = weights.astype(float), 0.0
    rest[0] /= 2  # the middle one belongs to both sides
    for k in range(len(rest) - 1, 0, -1):
        paired = rest[k - 1:k + 1].min()
        rest[k - 1:k + 1] -= paired
        share += 4 * paired
    return share


@fused
def filter_down(rows: np.ndarray, weights: np.ndarray, v: int, height: int, line: np.ndarray
                ) -> None:
    """
    Fill line (W + 2 r,) float32 with row v of an image filtered along its columns.

    rows (n, W) is a ring buffer: row i of the image, of this height, is at i modulo n; it holds
    all rows within r of v. The image is mirrored at its borders; the line extends r beyond them.
    """
    radius, count, width = len(weights) - 1, len(rows), rows.shape[1]
    inner = line[radius:radius + width]
    w, w_1, w_2 = weights[0], weights[1], weights[2]
    here = v % count
    above, below = _mirrored(v - 1, height) % count, _mirrored(v + 1, height) % count
    above_2, below_2 = _mirrored(v - 2, height) % count, _mirrored(v + 2, height) % count
    for x in range(width):
        inner[x] = (w * np.float32(rows[here, x])
                    + w_1 * (np.float32(rows[above, x]) + np.float32(rows[below, x]))
                    + w_2 * (np.float32(rows[above_2, x]) + np.float32(rows[below_2, x])))
    for k in range(3, radius, 2):
        w_1, w_2 = weights[k], weights[k + 1]
        above, below = _mirrored(v - k, height) % count, _mirrored(v + k, height) % count
        above_2 = _mirrored(v - k - 1, height) % count
        below_2 = _mirrored(v + k + 1, height) % count
        for x in range(width):
            inner[x] += (w_1 * (np.float32(rows[above, x]) + np.float32(rows[below, x]))
                         + w_2 * (np.float32(rows[above_2, x]) + np.float32(rows[below_2, x])))
    for k in range(1, radius + 1):
        line[radius - k] = inner[_mirrored(-k, width)]
        line[radius + width - 1 + k] = inner[_mirrored(width - 1 + k, width)]


@compiled
def filter_across(line: np.ndarray, weights: np.ndarray, begin: int, end: int, target: np.ndarray
                  ) -> None:
    """Fill target[begin:end] with line, a result of filter_down(), filtered along the row."""
    # Unsigned: an index that may be negative takes longer.
    first, last, middle = np.uintp(begin), np.uintp(end), np.uintp(len(weights) - 1)
    before, after = np.uintp(middle - 1), np.uintp(middle + 1)
    before_2, after_2 = np.uintp(middle - 2), np.uintp(middle + 2)
    w, w_1, w_2 = weights[0], weights[1], weights[2]
    for x in range(first, last):
        target[x] = (w * line[x + middle] + w_1 * (line[x + before] + line[x + after])
                     + w_2 * (line[x + before_2] + line[x + after_2]))
    for k in range(3, len(weights) - 1, 2):
        w_1, w_2 = weights[k], weights[k + 1]
        before, after = np.uintp(middle - k), np.uintp(middle + k)
        before_2, after_2 = np.uintp(middle - k - 1), np.uintp(middle + k + 1)
        for x in range(first, last):
            target[x] += (w_1 * (line[x + before] + line[x + after])
                          + w_2 * (line[x + before_2] + line[x + after_2]))


@compiled
def filtered_at(image: np.ndarray, weights: np.ndarray, u: int, v: int) -> float:
    """Return the filtered image at one pixel."""
    height, width = image.shape
    radius = len(weights) - 1
    total = 0.0
    if radius <= u < width - radius and radius <= v < height - radius:
        left, top = np.uintp(u - radius), np.uintp(v - radius)
        for y in range(2 * radius + 1):
            row, across = image[top + np.uintp(y)], 0.0
            for x in range(2 * radius + 1):
                across += weights[abs(x - radius)] * row[left + np.uintp(x)]
            total += weights[abs(y - radius)] * across
        return total
    for y in range(-radius, radius + 1):
        row = image[_mirrored(v + y, height)]
        across = 0.0
        for x in range(-radius, radius + 1):
            across += weights[abs(x)] * row[_mirrored(u + x, width)]
        total += weights[abs(y)] * across
    return total


@compiled
def _mirrored(index: int, count: int) -> int:
    if 0 <= index < count:
        return index
    index = abs(index) % (2 * count - 2)
    return min(index, 2 * count - 2 - index)
