# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pixel values of any number type as the 16-bit levels that star detection has."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_HIGHEST = 65535
_LEVELS_PER_NOISE = 4.0  # so that rounding adds 0.3 % to the noise
_LOW_PERCENT = 0.05

CELL_PX = 2
"""Side of a cell of a Bayer mosaic."""

# The sum of four 8-bit pixels is below; full_scale() of the star detection knows it.
_FULL_10_BIT = 1023
_SWAPPED_NOISE = 4.0  # times as large as with the other order of bytes
_STEP_ROWS = 8  # one in so many is sampled for the noise
_SAMPLED_ROWS, _SAMPLED_COLUMNS, _LEAST_SAMPLE = 64, 128, 1000


class Levels(NamedTuple):
    """An image (H, W) uint8 or uint16, and how much one of its levels was before."""

    image: np.ndarray
    step: float = 1.0


def sixteen_bit(pixels: np.ndarray) -> np.ndarray:
    """Return the image of levels_of()."""
    return levels_of(pixels).image


def levels_of(pixels: np.ndarray) -> Levels:
    """
    Return pixels (H, W) of any number type as levels; ValueError where no value is finite.

    Unsigned 8 and 16 bits stay; other integers that fit 16 bits are only shifted. The rest is
    scaled to the range of the values, or to four levels per 1 sigma of the noise where that is
    finer: what is brighter then counts as saturated. Undefined pixels become the median.
    """
    if pixels.dtype in (np.uint8, np.uint16):
        return Levels(pixels)
    finite = np.isfinite(pixels)
    if not finite.any():
        raise ValueError('no finite pixel')
    values = pixels.astype(np.float64)
    if not finite.all():
        values[~finite] = np.median(values[finite])
    low, high = float(values.min()), float(values.max())
    step = 1.0
    if not (pixels.dtype.kind in 'iu' and high - low <= _HIGHEST):
        low = float(np.percentile(values[::7, ::7], _LOW_PERCENT))
        step = max(high - low, np.finfo(float).tiny) / _HIGHEST
        # Of second differences, so that gradients of the sky do not count.
        noise = 1.4826 * float(np.median(np.abs(np.diff(values[::7], 2)[:, ::7]))) / np.sqrt(6)
        if noise > 0:
            step = min(step, noise / _LEVELS_PER_NOISE)
    return Levels(((values - low) / step).round().clip(0, _HIGHEST).astype(np.uint16), step)


def mosaic_levels(mosaic: np.ndarray) -> np.ndarray:
    """
    Return a Bayer mosaic (H, W) uint8 or uint16 as (H // 2, W // 2) uint16, a pixel for each cell.

    The levels are those of colour_levels() with four colours.
    """
    height, width = (CELL_PX * (side // CELL_PX) for side in mosaic.shape)
    return _joined([mosaic[v:height:CELL_PX, u:width:CELL_PX]
                    for v in range(CELL_PX) for u in range(CELL_PX)])


def colour_levels(image: np.ndarray) -> np.ndarray:
    """
    Return an image (H, W, C) uint8 or uint16 as (H, W) uint16, without loss of noise to rounding.

    Of 8 bits it is the sum of the colours, 1023 where one of them is saturated; of 16 bits their
    mean.
    """
    return _joined([image[..., colour] for colour in range(image.shape[2])])


def _joined(colours: Sequence[np.ndarray]) -> np.ndarray:
    """Return the levels (H, W) uint16 of colours (H, W) each."""
    first = colours[0]
    total = first.astype(np.uint16 if first.dtype == np.uint8 else np.uint32)
    brightest = first
    for colour in colours[1:]:
        total = total + colour
        brightest = np.maximum(brightest, colour)
    if first.dtype != np.uint8:
        return ((total + len(colours) // 2) // len(colours)).astype(np.uint16)
    total[brightest == np.iinfo(np.uint8).max] = _FULL_10_BIT
    return total


def rounds_noise(image: np.ndarray) -> bool:
    """Return whether the noise of an image (H, W) of integers is below one of its levels."""
    steps = np.diff(image[::_STEP_ROWS].astype(np.int32), axis=1)
    return bool(2 * np.count_nonzero(steps) < steps.size)


def has_swapped_bytes(image: np.ndarray) -> bool:
    """
    Return whether the noise of an image (H, W) uint16, or mosaic, is that of swapped bytes.

    Pixels differ little from those two next to them. With swapped bytes they differ by multiples
    of 256, unless the values are those of 8 bits, shifted up.
    """
    first = max(0, (image.shape[1] - _SAMPLED_COLUMNS) // 2)
    sample = np.ascontiguousarray(image[::max(1, len(image) // _SAMPLED_ROWS),
                                        first:first + _SAMPLED_COLUMNS])
    if _noise(sample) <= _SWAPPED_NOISE * _noise(sample.byteswap()):
        return False
    low = image & 0xff
    return bool((low != low[0, 0]).any())


def _noise(sample: np.ndarray) -> float:
    """Return the mean second difference of neighbours of one colour in rows (H, W)."""
    values = sample.astype(np.int32)
    second = values[:, :-4] - 2 * values[:, 2:-2] + values[:, 4:]
    return float(np.abs(second).mean()) if second.size >= _LEAST_SAMPLE else 0.0
