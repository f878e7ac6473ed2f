# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of an image that are those of the image before: a repeated or a torn frame."""

import numpy as np

COMPARED = 64  # rows of an image
LEAST_NOISY = 0.02  # share of a row's pixels that are not its median: it is no dead or dark row
LEAST_ROWS = 4


class StaleRows:
    """Compares each image with the one before; two exposures never have the same noise."""

    def __init__(self) -> None:
        self._before: np.ndarray | None = None

    def find(self, image: np.ndarray) -> tuple[int, int]:
        """
        Return the first and the last row that equal those of the image before; (0, 0) if none.

        They are the upper part of the image, the lower part, or all of it. Equal rows between
        others are no torn frame: the noise of such images, drawn or compressed, says nothing.
        """
        step = max(1, len(image) // COMPARED)
        sample, before = image[::step].copy(), self._before
        self._before = sample
        if before is None or before.shape != sample.shape or before.dtype != sample.dtype:
            return 0, 0
        if not (sample == before).all(axis=1).any():
            return 0, 0
        noisy = np.flatnonzero(np.mean(
            sample != np.median(sample, axis=1, keepdims=True), axis=1) >= LEAST_NOISY)
        stale = (sample[noisy] == before[noisy]).all(axis=1)
        changes = int(np.count_nonzero(stale[1:] != stale[:-1]))
        if len(noisy) < LEAST_ROWS or not stale.any() or changes > 1:
            return 0, 0
        rows = noisy[stale] * step
        return int(rows[0]), len(image) - 1 if stale[-1] else int(rows[-1])
