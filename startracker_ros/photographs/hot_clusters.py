# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Clusters of hot pixels in photographs, which look like sharp stars."""

import cv2
import numpy as np
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

# Clusters of 2 x 2 hot pixels: at least, the darkest pixel as a share of the brightest; at most, a
# pixel of the ring around them as a share of one of theirs, half of that of the sharpest star (PSF
# sigma 0.5 px); the height from which on noise hides no ring; how many there are at least.
_FLAT_SHARE, _RING_SHARE, _CLUSTER_SIGMAS, _FEWEST_CLUSTERS = 0.3, 0.015, 30.0, 10
_MARGIN_SIGMAS = 2.0
_CLUSTER, _WITH_RING, _WITH_LEVEL = 2, 4, 6  # sides of squares in px
_SAMPLE_ROWS = 8  # one in so many is sampled for the noise
_QUANTISATION_DN = 12 ** -0.5  # standard deviation of rounding to whole DN


def without_clusters(image: np.ndarray) -> np.ndarray:
    """
    Return an image (H, W) uint8 or uint16 without its clusters of 2 x 2 hot pixels.

    These have the level around them; an image with fewer than ten is returned as it is. The flux
    of a star that fills four pixels reaches the ring around them.
    """
    if min(image.shape) < _WITH_LEVEL:
        return image
    pixels, noise_dn = image.astype(np.float32), _pixel_noise(image)
    sums = [cv2.boxFilter(pixels, -1, (side, side), anchor=(side // 2 - 1, side // 2 - 1),
                          normalize=False) for side in (_CLUSTER, _WITH_RING, _WITH_LEVEL)]
    level = (sums[2] - sums[1]) / (_WITH_LEVEL ** 2 - _WITH_RING ** 2)
    ring = (sums[1] - sums[0]) / (_WITH_RING ** 2 - _CLUSTER ** 2) - level
    height = sums[0] / _CLUSTER ** 2 - level
    cell, anchor = np.ones((_CLUSTER, _CLUSTER), np.uint8), (0, 0)
    darkest = cv2.erode(pixels, cell, anchor=anchor) - level
    brightest = cv2.dilate(pixels, cell, anchor=anchor) - level
    noise_of_ring_dn = noise_dn / np.sqrt(_WITH_RING ** 2 - _CLUSTER ** 2)
    v, u = np.nonzero((height > _CLUSTER_SIGMAS * max(noise_dn, 1 / 12 ** 0.5))
                      & (darkest > _FLAT_SHARE * brightest)
                      & (ring < _RING_SHARE * height + _MARGIN_SIGMAS * noise_of_ring_dn))
    if len(v) < _FEWEST_CLUSTERS:
        return image
    clean = image.copy()
    for y in range(_CLUSTER):
        for x in range(_CLUSTER):
            inside = (v + y < image.shape[0]) & (u + x < image.shape[1])
            clean[v[inside] + y, u[inside] + x] = np.rint(level[v[inside], u[inside]])
    return clean


def _pixel_noise(image: np.ndarray) -> float:
    """Return the noise of a pixel of image (H, W), 1 sigma in DN, by the steps along its rows."""
    steps = np.diff(image[::_SAMPLE_ROWS].astype(np.int32), axis=1)
    return max(SIGMA_PER_MAD * float(np.median(np.abs(steps))) / 2 ** 0.5, _QUANTISATION_DN)
