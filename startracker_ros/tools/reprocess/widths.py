# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How wide star images are over the image, from the scatter of their centroids."""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.tools.reprocess.frame_fit import FrameFit

GRID = 8
"""Cells of the map on each axis of the image."""

WIDTH_DTYPE = np.dtype([('stamp_ns', 'i8'), ('column', 'i2'), ('row', 'i2'), ('count', 'i4'),
                        ('square_px2', 'f8')])
"""Sums over a segment for each cell of the image: stars, and s^2 of width_px()."""

_ATTITUDE = 3
"""What the fit of a frame takes out of the residuals of its stars."""


class FittedStars(NamedTuple):
    """The stars (K,) of a frame's fit: hip, uv (K, 2) px and SNR."""

    hip: np.ndarray
    uv: np.ndarray
    snr: np.ndarray


NO_STARS = FittedStars(np.empty(0, np.int32), np.empty((0, 2)), np.empty(0))


def width_rows(frames: Sequence[tuple[FittedStars, FrameFit]], camera: Camera, begin_ns: int
               ) -> np.ndarray:
    """
    Return the table widths of a segment.

    A Gaussian image of width s (1 sigma), in the noise of the background, has centroids of error
    sqrt(2) s / SNR per axis. Clouds do not hold the width that was fitted, so s^2 is the mean of
    (residual SNR)^2 / 2 on an axis. A residual of FrameFit contains the errors of the others: the
    variance of K stars is too large by 1 / (1 - 3 / (2 K)) on average.
    """
    if not frames:
        return np.empty(0, WIDTH_DTYPE)
    count = [len(stars.hip) for stars, _ in frames]
    own = np.repeat([1 - _ATTITUDE / (2 * stars) for stars in count], count)
    residual_px = np.concatenate([fit.residual for _, fit in frames]) / camera.pixel_rad
    snr = np.concatenate([stars.snr for stars, _ in frames])
    square = own * (residual_px ** 2).mean(axis=1) * snr ** 2 / 2
    cells = (np.concatenate([stars.uv for stars, _ in frames]) + 0.5) * GRID / [
        camera.width, camera.height]
    column, row = np.clip(cells.astype(int), 0, GRID - 1).T
    known = np.isfinite(square)
    cell = (row * GRID + column)[known]
    stars = np.bincount(cell, minlength=GRID ** 2)
    rows = np.zeros(np.count_nonzero(stars), WIDTH_DTYPE)
    rows['row'], rows['column'] = np.divmod(np.flatnonzero(stars), GRID)
    rows['stamp_ns'], rows['count'] = begin_ns, stars[stars > 0]
    rows['square_px2'] = np.bincount(cell, square[known], GRID ** 2)[stars > 0]
    return rows


def width_px(square_px2: float, count: int) -> tuple[float, float]:
    """Return the width of sums over stars and its 1 sigma, NaN of none."""
    if not count:
        return math.nan, math.nan
    width = math.sqrt(square_px2 / count)
    return width, width / (2 * math.sqrt(count))
