"""The matched filter of stars, row by row: the filtered image is never stored as a whole."""

from typing import NamedTuple

import numpy as np

from startracker_ros.compiled import compiled


class Kernel(NamedTuple):
    """A Gaussian along rows and columns; weights (r + 1,) float32 its middle and one side, r even.

    sigma_px is its width; noise_gain what it leaves of white noise.
    """

    weights: np.ndarray
    sigma_px: float
    noise_gain: float


def gaussian_kernel(sigma_px: float) -> Kernel:
    """Return the filter for stars of this width.

    A Gaussian of the width of the point spread function is the matched filter of stars;
    with a width wrong by a factor q it keeps 2 q / (1 + q^2) of the signal to noise ratio.
    """
    side = np.exp(-0.5 * (np.arange(np.ceil(2 * sigma_px) + 1) / sigma_px) ** 2)
    side /= 2 * side.sum() - side[0]
    weights = np.zeros(len(side) + 1 - len(side) % 2, np.float32)
    weights[:len(side)] = side
    return Kernel(weights, float(sigma_px), float(2 * (side ** 2).sum() - side[0] ** 2))


@compiled
def filter_row(image, weights, row, line, target):
    """Fill target (W,) float32 with a filtered row of image (H, W), mirrored at its borders.

    line (W + 2 r,) float32 is memory to work in.
    """
    height, width = image.shape
    radius = len(weights) - 1
    inner = line[radius:radius + width]
    _begin(inner, weights, image[row],
           image[_mirrored(row - 1, height)], image[_mirrored(row + 1, height)],
           image[_mirrored(row - 2, height)], image[_mirrored(row + 2, height)])
    for k in range(3, radius, 2):
        _add(inner, weights[k:],
             image[_mirrored(row - k, height)], image[_mirrored(row + k, height)],
             image[_mirrored(row - k - 1, height)], image[_mirrored(row + k + 1, height)])
    for k in range(1, radius + 1):
        line[radius - k] = inner[_mirrored(-k, width)]
        line[radius + width - 1 + k] = inner[_mirrored(width - 1 + k, width)]
    _begin(target, weights, inner, line[radius - 1:], line[radius + 1:],
           line[radius - 2:], line[radius + 2:])
    for k in range(3, radius, 2):
        _add(target, weights[k:], line[radius - k:], line[radius + k:],
             line[radius - k - 1:], line[radius + k + 1:])


@compiled
def filtered_at(image, weights, u, v):
    """Return the filtered image at one pixel."""
    height, width = image.shape
    radius = len(weights) - 1
    total = 0.0
    for y in range(-radius, radius + 1):
        row = image[_mirrored(v + y, height)]
        across = 0.0
        for x in range(-radius, radius + 1):
            across += weights[abs(x)] * row[_mirrored(u + x, width)]
        total += weights[abs(y)] * across
    return total


@compiled
def _mirrored(index, count):
    if 0 <= index < count:
        return index
    index = abs(index) % (2 * count - 2)
    return min(index, 2 * count - 2 - index)


@compiled
def _begin(target, weights, middle, before, after, before_2, after_2):
    """Set target (W,) to the first five taps."""
    w, w_1, w_2 = weights[0], weights[1], weights[2]
    for x in range(len(target)):
        target[x] = (w * np.float32(middle[x])
                     + w_1 * (np.float32(before[x]) + np.float32(after[x]))
                     + w_2 * (np.float32(before_2[x]) + np.float32(after_2[x])))


@compiled
def _add(target, weights, before, after, before_2, after_2):
    """Add four more taps to target (W,)."""
    w_1, w_2 = weights[0], weights[1]
    for x in range(len(target)):
        target[x] += (w_1 * (np.float32(before[x]) + np.float32(after[x]))
                      + w_2 * (np.float32(before_2[x]) + np.float32(after_2[x])))
