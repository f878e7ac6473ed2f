# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Spots of any shape: all flux above the background that is connected.

Coma, trails, colour mosaics, clipping and compression give stars shapes that no model has. Every
connected spot of the smoothed image above the threshold may be a star, the brightest ones first,
unless it is as large as a cloud or a building, or a part of the border of something bright: of the
sky above trees, or of a lit wall. Its position is the centre of its flux, with an
error that follows its size.
"""

import cv2
import numpy as np
from startracker_ros.core.centroid.background import measure_background, over_image, readable
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.smoothing import gaussian_kernel
from startracker_ros.core.compiled import compiled

CELLS = 8  # along each side of the image,
CELL_SHARE = 4.0  # each of which gets so many times its share of the spots
MAX_STARS = 60
BRIGHT_SPOTS, FAINTEST_SHARE = 12, 0.25
_FILTER_SIGMA_PX = 1.0
_THRESHOLD_SIGMAS = 5.0
# Least height above the background: quantised and clipped backgrounds have no noise to measure.
_LEAST_DN = 1.5
_MAX_SIDE_PX = 30.0  # of a spot, in an image of 1024 px; no star is as large
_REFERENCE_PX = 1024
# A spot is above all but a quarter of a ring this far outside it by half of its height at least.
# The border of a straight edge is not.
_RING_PX, _RING, _RING_HIGHEST, _RING_SHARE = 3.0, 16, 12, 0.5
_TURN = 2 * np.pi * np.arange(_RING)[:, None] / _RING
_RING_DIRECTIONS = np.hstack([np.cos(_TURN), np.sin(_TURN)])
# Of the sky at most this share of a square about a spot, the longest side of the image over so
# many, is above the threshold, or more in a crowded image.
_CALM_SHARE, _CALM_SIDES = 0.05, 24
_SAME_PX = 1.5  # a fitted position this close to the centre of the flux is of the same star
_SIZE_SHARE = 0.2  # of the size of a spot that its centre is off, beyond noise


def find_spots(image: np.ndarray, cell_share: float = CELL_SHARE, calm: bool = False) -> Centroids:
    """
    Return the connected spots of an image (H, W), the brightest first; share as in brightest().

    Calm ones only: not those of trees, buildings and text, which are close together.
    """
    image = readable(image)
    height, width = image.shape
    mesh = measure_background(image, gaussian_kernel(_FILTER_SIGMA_PX))
    level = over_image(mesh.level, image.shape)
    smooth = cv2.GaussianBlur(image - level, (0, 0), _FILTER_SIGMA_PX)
    threshold = over_image(np.maximum(_THRESHOLD_SIGMAS * mesh.noise, _LEAST_DN), image.shape)
    above = smooth > threshold
    pixel = np.flatnonzero(above)
    v, u = np.divmod(pixel, width)
    spot, count = connected_spots(u, v, width, height)
    flux, noise = smooth.ravel()[pixel].astype(float), threshold.ravel()[pixel]
    largest = _MAX_SIDE_PX * max(1.0, max(image.shape) / _REFERENCE_PX)
    total = np.bincount(spot, flux, count)
    side = _sides(spot, count, u, v)
    chosen = np.flatnonzero(side <= largest)
    centre = np.stack([np.bincount(spot, flux * x, count) / total for x in (u, v)], -1)
    smooth += level
    peak = np.zeros(count)
    np.maximum.at(peak, spot, flux)
    chosen = chosen[_isolated(smooth, level, centre[chosen], side[chosen], peak[chosen])]
    if calm:
        busy = _surroundings(above, centre[chosen], np.bincount(spot, minlength=count)[chosen])
        chosen = chosen[busy <= np.sort(busy)[:MAX_STARS].max(initial=_CALM_SHARE)]
    chosen = chosen[np.argsort(-total[chosen], kind='stable')]
    # Letters and lit windows are bright and close together.
    chosen = chosen[brightest(centre[chosen], image.shape, MAX_STARS, cell_share)]
    square = np.bincount(spot, flux * ((u - centre[spot, 0]) ** 2
                                        + (v - centre[spot, 1]) ** 2), count) / total / 2
    size = np.sqrt(square + 1 / 12)
    variance = np.bincount(spot, (noise / _THRESHOLD_SIGMAS) ** 2, count)
    snr = total / np.sqrt(variance)
    sigma_px = np.hypot(size / np.maximum(snr, 1), _SIZE_SHARE * size)
    return Centroids(centre[chosen], total[chosen], snr[chosen], sigma_px[chosen])


def _sides(spot: np.ndarray, count: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the longer side (count,) in px of each spot, of pixels u, v of spot (N,)."""
    longer = np.zeros(count)
    for x in (u, v):
        low, high = np.full(count, x.max(initial=0)), np.zeros(count, int)
        np.minimum.at(low, spot, x)
        np.maximum.at(high, spot, x)
        longer = np.maximum(longer, high - low + 1)
    return longer


def _isolated(smooth: np.ndarray, level: np.ndarray, centre: np.ndarray, side: np.ndarray,
              height: np.ndarray) -> np.ndarray:
    """
    Return whether spots (N,) stand out from their surroundings, not from a level alone.

    smooth and level (H, W) are the filtered image and its background; centre (N, 2), side (N,) and
    the height (N,) above the level are those of the spots.
    """
    at = centre[:, None] + (side / 2 + _RING_PX)[:, None, None] * _RING_DIRECTIONS
    u, v = np.rint(at).astype(int).clip(0, np.array(smooth.shape[::-1]) - 1).transpose(2, 0, 1)
    around = np.partition(smooth[v, u], _RING_HIGHEST, axis=1)[:, _RING_HIGHEST]
    u, v = np.rint(centre).astype(int).T
    return level[v, u] + height - around > _RING_SHARE * height


def _surroundings(above: np.ndarray, centre: np.ndarray, own: np.ndarray) -> np.ndarray:
    """
    Return the share (N,) of the pixels about spots that are above the threshold.

    above (H, W) is whether a pixel is; centre (N, 2) are those of the spots, own (N,) how many
    pixels each has itself.
    """
    side = max(above.shape) // _CALM_SIDES
    u, v = np.rint(centre).astype(int).T
    return cv2.blur(above.astype(np.float32), (side, side))[v, u] - own / side ** 2


def fitted_where_close(spots: Centroids, fitted: Centroids) -> Centroids:
    """Return the spots, with position and error of the fitted stars at their centres."""
    if not len(fitted):
        return spots
    distance = np.linalg.norm(spots.uv[:, None] - fitted.uv, axis=-1)
    nearest = distance.argmin(axis=1)
    same = distance[np.arange(len(spots)), nearest] < _SAME_PX
    uv, sigma_px = spots.uv.copy(), spots.sigma_px.copy()
    uv[same], sigma_px[same] = fitted.uv[nearest[same]], fitted.sigma_px[nearest[same]]
    return Centroids(uv, spots.flux, spots.snr, sigma_px)


def with_near_spots(stars: Centroids, spots: Centroids, uv: np.ndarray, radius_px: np.ndarray
                    ) -> Centroids:
    """Return fitted stars and other spots within radius_px (K,) of positions uv (K, 2)."""
    distance = np.linalg.norm(spots.uv[:, None] - uv, axis=-1)
    return _joined(stars, _others(spots.select((distance < radius_px).any(axis=1)), stars))


def explained_spots(spots: Centroids, stars: Centroids, reach_px: float = 0.0) -> int:
    """Return how many of the BRIGHT_SPOTS brightest spots have a star closer than reach_px."""
    if not len(stars):
        return 0
    distance = np.linalg.norm(spots.uv[:BRIGHT_SPOTS, None] - stars.uv, axis=-1)
    return int(np.count_nonzero((distance < reach_px + _SAME_PX).any(axis=1)))


def with_spots(stars: Centroids, spots: Centroids, most: int) -> Centroids:
    """
    Return fitted stars and the bright spots that are none of them, brightest first.

    Faint spots are mostly no stars: as soon as there are BRIGHT_SPOTS, the limit is the flux that
    FAINTEST_SHARE of the fitted ones do not reach. Half of the list of `most` stars is left to
    these.
    """
    spots = _others(spots, stars)
    short = max(BRIGHT_SPOTS - len(stars), 0)
    faintest = np.quantile(stars.flux, FAINTEST_SHARE) if len(stars) else 0.0
    bright = (spots.flux > faintest) | (np.arange(len(spots)) < short)
    return _joined(stars, spots.select(bright).select(slice(max(most // 2, most - len(stars)))))


def _others(spots: Centroids, stars: Centroids) -> Centroids:
    """Return the spots that are none of the stars."""
    if not len(stars):
        return spots
    distance = np.linalg.norm(spots.uv[:, None] - stars.uv, axis=-1)
    return spots.select(distance.min(axis=1) > _SAME_PX)


def _joined(stars: Centroids, spots: Centroids) -> Centroids:
    """Return both, brightest first."""
    joined = stars.joined(spots)
    return joined.select(np.argsort(-joined.flux, kind='stable'))


@compiled
def connected_spots(u: np.ndarray, v: np.ndarray, width: int, height: int
                    ) -> tuple[np.ndarray, int]:
    """
    Return the number (N,) of the spot of each of the pixels u, v (N,), and how many there are.

    The pixels are in the order of the image, (width, height) px. Those that touch, by a side or a
    corner, are one spot. Union of sets with halved paths (Tarjan 1975).
    """
    parent = np.arange(len(u))
    # One more than the pixel that is there, 0 for none.
    seen = np.zeros((height + 1, width + 2), np.int32)
    for i in range(len(u)):
        row, column = v[i] + 1, u[i] + 1
        for r, c in ((row, column - 1), (row - 1, column - 1), (row - 1, column),
                     (row - 1, column + 1)):
            if seen[r, c]:
                one, other = _first(parent, i), _first(parent, seen[r, c] - 1)
                parent[max(one, other)] = min(one, other)
        seen[row, column] = i + 1
    spot, count = np.empty(len(u), np.int64), 0
    for i in range(len(u)):
        if parent[i] == i:
            spot[i] = count
            count += 1
        else:
            spot[i] = spot[_first(parent, i)]
    return spot, count


@compiled
def _first(parent: np.ndarray, i: int) -> int:
    """Return the first pixel of the set of pixel i."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


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
