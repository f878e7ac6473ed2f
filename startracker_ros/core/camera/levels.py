# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pixel values of any number type as the 16-bit levels that star detection has."""

from typing import NamedTuple

import numpy as np

_HIGHEST = 65535
_LEVELS_PER_NOISE = 4.0  # so that rounding adds 0.3 % to the noise
_LOW_PERCENT = 0.05


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
