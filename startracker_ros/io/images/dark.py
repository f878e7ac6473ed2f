# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a camera shows without light: dark frames, and lists of bad pixels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from startracker_ros.core.camera.levels import sixteen_bit
from startracker_ros.io.images.images import ImageError, Photograph, read_photograph

_LISTS = '.txt', '.csv'
_LARGEST_LIST_BYTES = 50_000_000
_REACH_PX = 2  # of the good pixels whose median a bad one gets
_PART = 100_000  # bad pixels at a time


@dataclass(frozen=True)
class Dark:
    """
    A dark frame, or the pixels (N, 2) that are bad; the other one is None.

    name is that of its file.
    """

    name: str
    frame: Photograph | None = None
    bad_px: np.ndarray | None = None

    def subtracted(self, photograph: Photograph) -> Photograph:
        """Return a photograph without it; ImageError where it is of another camera."""
        image = photograph.image
        if self.bad_px is not None:
            return photograph._replace(image=self._repaired(image, self.bad_px))
        assert self.frame is not None
        dark = self.frame.image
        if dark.shape != image.shape:
            raise ImageError(
                f'dark frame {self.name}: {dark.shape[1]} x {dark.shape[0]} px, the image has '
                f'{image.shape[1]} x {image.shape[0]}')
        # In levels of the image, whose noise stays; less than the dark frame is not a loss.
        left = image - np.rint(dark * (self.frame.step / photograph.step))
        return photograph._replace(image=sixteen_bit(left.astype(np.int32)))

    def _repaired(self, image: np.ndarray, bad_px: np.ndarray) -> np.ndarray:
        """Return an image whose bad pixels have the median of the good ones around them."""
        height, width = image.shape
        beyond = (bad_px < 0).any(axis=1) | (bad_px >= [width, height]).any(axis=1)
        if beyond.any():
            u, v = bad_px[beyond][0]
            raise ImageError(f'bad pixels {self.name}: {u},{v} is not in the image of {width} x '
                             f'{height} px')
        good = image.astype(np.float32)
        good[bad_px[:, 1], bad_px[:, 0]] = np.nan
        good = np.pad(good, _REACH_PX, constant_values=np.nan)
        around = np.arange(2 * _REACH_PX + 1)
        repaired, level = image.copy(), np.median(image)
        for part in range(0, len(bad_px), _PART):
            u, v = bad_px[part:part + _PART].T
            near = good[v[:, None, None] + around[:, None], u[:, None, None] + around]
            near = near.reshape(len(u), -1)
            near[np.isnan(near).all(axis=1)] = level
            repaired[v, u] = np.rint(np.nanmedian(near, axis=1)).astype(image.dtype)
        return repaired


def read_dark(path: str | Path) -> Dark:
    """
    Return a dark frame, or of a .txt or .csv file the bad pixels.

    Its lines are u,v of a pixel, (0, 0) the first one of the image upright; what follows # is a
    comment. ImageError for a file that is neither.
    """
    path = Path(path)
    if path.suffix.lower() not in _LISTS:
        return Dark(str(path), read_photograph(path))
    try:
        with path.open('rb') as file:
            text = file.read(_LARGEST_LIST_BYTES).decode('utf-8', 'replace')
    except OSError as error:
        raise ImageError(f'{path}: {error.strerror}') from error
    pixels = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition('#')[0].replace(',', ' ').split()
        if words:
            try:
                u, v = map(int, words)
            except ValueError:
                raise ImageError(
                    f'{path}, line {number}: {line.strip()!r} is not a u,v of a pixel') from None
            pixels.append((u, v))
    if not pixels:
        raise ImageError(f'{path}: no pixels in it')
    return Dark(str(path), bad_px=np.array(pixels))
