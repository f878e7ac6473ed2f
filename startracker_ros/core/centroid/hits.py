# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Pixels hit by particles, and hot pixels: sharper than any star image.

The flux of a star of PSF sigma falls into the pixels around its brightest one. Of the four
next to it, the third brightest has at least a share r(sigma) of it, wherever the star is within
its pixel; a hit leaves three of the four dark, or all. A lens is sharper here than there: r is
that of a star narrower than the median.
"""

from functools import lru_cache

import cv2
import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh, pixel_noise, readable
from startracker_ros.core.centroid.psf import profile, SHARE
from startracker_ros.core.centroid.shape import LONE_PIXEL
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.sorting import insert_sorted

NARROWEST = 0.7  # star, in PSF sigmas of the median one
MARGIN_SIGMAS = 2.0
STORM_PEAKS = 30  # single pixels among the peaks, from which on hits are removed from the image
BRIGHT_PEAKS = 100
DARK_SHARE = 0.1  # of the brightest pixel: flux in the eight around it, in a storm
HIT_SIGMAS = 8.0
TRACK_PX = 5  # removed pixel by pixel from both ends
# Clusters of 2 x 2 hot pixels: at least, the darkest pixel as a share of the brightest; at most, a
# pixel of the ring around them as a share of one of theirs, half of that of the sharpest star (PSF
# sigma 0.5 px); the height from which on noise hides no ring; how many there are at least.
_FLAT_SHARE, _RING_SHARE, _CLUSTER_SIGMAS, _FEWEST_CLUSTERS = 0.3, 0.015, 30.0, 10
_CLUSTER, _WITH_RING, _WITH_LEVEL = 2, 4, 6  # sides of squares in px
_AROUND = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))
_PHASES = np.linspace(-0.5, 0.5, 11)


def is_hit(image: np.ndarray, uv: np.ndarray, level: np.ndarray, noise_dn: np.ndarray,
           sigma_px: float) -> np.ndarray:
    """
    Return which peaks (K,) at pixels uv (K, 2) are sharper than a star of this PSF sigma.

    level and noise_dn (K,) are those of a background pixel.
    """
    return are_sharper(image, uv, level, noise_dn, least_share(sigma_px))


def least_share(sigma_px: float) -> float:
    """Return r of the narrowest stars where the median one has this PSF sigma."""
    return _least_share(round(NARROWEST * sigma_px, 2))


@lru_cache(maxsize=16)
def _least_share(sigma_px: float) -> float:
    """Return r, the least share of the third brightest neighbour over all phases of a star."""
    share, least = np.empty((3, 3), np.float32), np.inf
    lines = []
    for phase in _PHASES:
        profile(float(phase), max(sigma_px, 0.2), -1, share)
        lines.append(share[SHARE].astype(float))
    for across in lines:
        for down in lines:
            around = sorted([across[0] / across[1], across[2] / across[1],
                             down[0] / down[1], down[2] / down[1]])
            least = min(least, around[1])
    return float(least)


@compiled
def are_sharper(image: np.ndarray, uv: np.ndarray, level: np.ndarray, noise_dn: np.ndarray,
                share: float) -> np.ndarray:
    """Return what is_hit() does, for the least share of the third brightest neighbour."""
    hit = np.zeros(len(uv), np.bool_)
    around = np.empty(4)
    for i in range(len(uv)):
        u, v = _brightest_of_nine(image, uv[i, 0], uv[i, 1])
        if not (0 < u < image.shape[1] - 1 and 0 < v < image.shape[0] - 1):
            continue
        insert_sorted(around, 0, float(image[v, u - 1]))
        insert_sorted(around, 1, float(image[v, u + 1]))
        insert_sorted(around, 2, float(image[v - 1, u]))
        insert_sorted(around, 3, float(image[v + 1, u]))
        least = share * (image[v, u] - level[i]) - MARGIN_SIGMAS * noise_dn[i]
        hit[i] = around[1] - level[i] < least
    return hit


@compiled
def _brightest_of_nine(image: np.ndarray, u: int, v: int) -> tuple[int, int]:
    best_u, best_v = u, v
    for y in range(max(v - 1, 0), min(v + 2, image.shape[0])):
        for x in range(max(u - 1, 0), min(u + 2, image.shape[1])):
            if image[y, x] > image[best_v, best_u]:
                best_u, best_v = x, y
    return best_u, best_v


@compiled
def _share_around(image: np.ndarray, u: int, v: int, level: float) -> float:
    """Return the flux in the pixels around the brightest one at u, v over that of this one."""
    u, v = _brightest_of_nine(image, u, v)
    around = count = 0.0
    for y in range(max(v - 1, 0), min(v + 2, image.shape[0])):
        for x in range(max(u - 1, 0), min(u + 2, image.shape[1])):
            if x != u or y != v:
                around, count = around + image[y, x], count + 1
    return (around - count * level) / max(image[v, u] - level, 1.0)


@compiled
def is_single(image: np.ndarray, uv: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return which peaks (K,) at uv (K, 2) are one pixel, with hardly any flux around it."""
    single = np.empty(len(uv), np.bool_)
    for i in range(len(uv)):
        single[i] = abs(_share_around(image, uv[i, 0], uv[i, 1], level[i])) <= LONE_PIXEL
    return single


@compiled
def is_storm(image: np.ndarray, uv: np.ndarray, level: np.ndarray) -> bool:
    """
    Return whether the peaks uv (K, 2), brightest first, are hits for the most part.

    Stars are distinguished even if they are narrower than a pixel: some lie between two pixels.
    """
    shares = np.empty(min(len(uv), BRIGHT_PEAKS))
    single = 0
    for i in range(len(shares)):
        shares[i] = _share_around(image, uv[i, 0], uv[i, 1], level[i])
        single += abs(shares[i]) <= LONE_PIXEL
    return bool(single >= STORM_PEAKS and np.median(shares) < DARK_SHARE)


def without_hits(image: np.ndarray, mesh: Mesh, noise_dn: float, sigma_px: float
                 ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a copy of image (H, W) without hits, and the mask (H, W) of the pixels changed.

    A pixel brighter than its eight neighbours and sharper than a star of this PSF sigma gets their
    median; then the next one of the same track is the brightest.
    """
    return _without_hits(image, mesh, noise_dn, least_share(sigma_px))


@compiled
def _without_hits(image: np.ndarray, mesh: Mesh, noise_dn: float, share: float
                  ) -> tuple[np.ndarray, np.ndarray]:
    clean, hit = image.copy(), np.zeros(image.shape, np.bool_)
    around, lowest = np.empty(8), HIT_SIGMAS * noise_dn
    for _ in range(TRACK_PX):
        for v in range(1, image.shape[0] - 1):
            for u in range(1, image.shape[1] - 1):
                here = clean[v, u]
                # Most pixels end here.
                if here < clean[v, u - 1] or here < clean[v, u + 1] or here < clean[v - 1, u]:
                    continue
                level, _ = background_at(mesh, u, v)
                if here - level < lowest:
                    continue
                for k in range(4):
                    y, x = _AROUND[k]
                    insert_sorted(around, k, float(clean[v + y, u + x]))
                if around[1] - level >= share * (here - level) - MARGIN_SIGMAS * noise_dn:
                    continue
                for k in range(4, 8):
                    y, x = _AROUND[k]
                    insert_sorted(around, k, float(clean[v + y, u + x]))
                if here >= around[7]:
                    clean[v, u], hit[v, u] = max((around[3] + around[4]) / 2, 0.0), True
    return clean, hit


def without_clusters(image: np.ndarray) -> np.ndarray:
    """
    Return an image (H, W) uint8 or uint16 without its clusters of 2 x 2 hot pixels.

    These have the level around them; an image with fewer than ten is returned as it is. The flux
    of a star that fills four pixels reaches the ring around them.
    """
    if min(image.shape) < _WITH_LEVEL:
        return image
    pixels, noise_dn = image.astype(np.float32), pixel_noise(readable(image))
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
                      & (ring < _RING_SHARE * height + MARGIN_SIGMAS * noise_of_ring_dn))
    if len(v) < _FEWEST_CLUSTERS:
        return image
    clean = image.copy()
    for y in range(_CLUSTER):
        for x in range(_CLUSTER):
            inside = (v + y < image.shape[0]) & (u + x < image.shape[1])
            clean[v[inside] + y, u[inside] + x] = np.rint(level[v[inside], u[inside]])
    return clean
