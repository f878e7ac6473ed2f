# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Local background and noise on a coarse mesh, measured in the smoothed image."""

from typing import NamedTuple

import cv2
import numpy as np
from startracker_ros.core.centroid.smoothing import filter_across, filter_down, Kernel
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.sorting import insert_sorted, SIGMA_PER_MAD

TILE_PX = 64
LEAST_TILE_SIGMAS = 16.0  # side of the smallest tile, in PSF sigmas: most of it is sky
BEND_SIGMAS = 0.25  # of the level within a tile, from which on tiles are halved,
BENT_SHARE = 0.25  # in so many of them
CHANGED_SIGMAS = 1.5  # of a pixel, by which the level has changed
CHANGED_SHARE = 0.25  # at so many places
RING_PX = 9  # from a star, where that is measured
SAMPLE_ROWS = 8  # rows sampled in a tile; each has to be filtered,
SAMPLES = 16  # so that the pixels along it cost little
QUANTISATION_DN = 12 ** -0.5  # standard deviation of rounding to whole DN
TAIL_QUANTILE = 0.95  # shows a skewed noise and is not yet made of stars
TAIL_SIGMAS = 1.6449  # the same quantile of a normal distribution
TAIL_SAMPLES = 16384
MAX_SIGMAS = 100.0  # to which samples are limited
MAX_TAIL_RATIO = 1.5  # a longer tail is made of stars
STEPS_PER_DN = 256  # of samples as int32
_ANGLES = np.arange(16) * np.pi / 8
_RING = np.rint(RING_PX * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)).astype(np.int64)
_FROM_MIDDLE = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5).astype(np.float32)  # in tiles
_BEFORE_MIDDLE, _AFTER_MIDDLE = _FROM_MIDDLE.clip(max=0), _FROM_MIDDLE.clip(min=0)


class Mesh(NamedTuple):
    """
    Background of an image; level and noise (rows + 2, columns + 2) have a value per tile.

    One more tile on each side continues them linearly. level in DN; noise, 1 sigma in DN, is
    that of the smoothed image. The medians are of the inner tiles. scale holds tiles per
    pixel, down and across.
    """

    level: np.ndarray
    noise: np.ndarray
    median_level: float
    median_noise: float
    scale: tuple[float, float]

    def scaled(self, factor: float) -> 'Mesh':
        """Return the mesh with its noise multiplied by factor."""
        return self._replace(noise=factor * self.noise, median_noise=factor * self.median_noise)


def readable(image: np.ndarray) -> np.ndarray:
    """Return the image as compiled functions know it: uint16, in one block and read-only."""
    # One type, so that each function is compiled once. Read-only, as in images out of DDS.
    if image.dtype != np.uint16 or not (image.flags.c_contiguous and image.flags.aligned):
        image = np.require(image, np.uint16, ['C', 'A'])
    image = image.view()
    image.flags.writeable = False
    return image


def measure_background(image: np.ndarray, kernel: Kernel) -> Mesh:
    """
    Return the mesh of image (H, W) after smoothing: median and scaled MAD of each tile.

    The smoothed image is measured because averaging undoes the quantisation that makes the
    MAD of an 8-bit image 0 or 1, and because correlated noise then counts with its effect on
    a star. Where the noise is skewed, as in a camera whose background is cut off at zero, the
    MAD is scaled up to the upper tail, which makes the false stars. Tiles are halved where the
    level is no plane between their middles, as in a glare: what it leaves would count as noise.
    """
    height, width = image.shape
    # As images out of DDS: it is compiled for these only.
    image = image.view()
    image.flags.writeable = False
    side = TILE_PX
    while True:
        rows, columns = max(1, round(height / side)), max(1, round(width / side))
        level, noise, median_level, median_noise = _measure(image, kernel, rows, columns)
        side //= 2
        if side < LEAST_TILE_SIGMAS * kernel.sigma_px or not _is_bent(level, median_noise):
            return Mesh(level, noise, median_level, median_noise,
                        (rows / height, columns / width))


def over_image(tiles: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the level or the noise of a mesh at each pixel (H, W), float32."""
    height, width = shape
    inner = tiles[1:-1, 1:-1].astype(np.float32)
    return cv2.resize(inner, (width, height), interpolation=cv2.INTER_LINEAR)


def pixel_noise(image: np.ndarray) -> float:
    """
    Return the noise of a pixel of image (H, W), 1 sigma in DN, by the steps along its rows.

    Hits on some pixels leave it as it is, while the filter gives each the size of a star.
    """
    steps = np.diff(image[::SAMPLE_ROWS].astype(np.int32), axis=1)
    return max(SIGMA_PER_MAD * float(np.median(np.abs(steps))) / 2 ** 0.5, QUANTISATION_DN)


@compiled
def interpolate(mesh: np.ndarray, y: float, x: float) -> float:
    """Return the value at y tiles down and x tiles across, bilinear."""
    i = min(max(int(y), 0), mesh.shape[0] - 2)
    j = min(max(int(x), 0), mesh.shape[1] - 2)
    y, x = y - i, x - j
    return ((1 - y) * ((1 - x) * mesh[i, j] + x * mesh[i, j + 1])
            + y * ((1 - x) * mesh[i + 1, j] + x * mesh[i + 1, j + 1]))


@compiled
def interpolate_row(mesh: np.ndarray, y: float, at_tile: np.ndarray) -> None:
    """Fill at_tile (columns,) with the values at y tiles down, in the middles of the tiles."""
    i = min(max(int(y), 0), mesh.shape[0] - 2)
    for j in range(len(at_tile)):
        at_tile[j] = (i + 1 - y) * mesh[i, j] + (y - i) * mesh[i + 1, j]


@compiled
def background_at(mesh: Mesh, u: int, v: int) -> tuple[float, float]:
    """Return level and noise at a pixel."""
    y, x = (v + 0.5) * mesh.scale[0] + 0.5, (u + 0.5) * mesh.scale[1] + 0.5
    return interpolate(mesh.level, y, x), interpolate(mesh.noise, y, x)


@compiled
def slope_at(mesh: Mesh, u: int, v: int, radius: int) -> tuple[float, float]:
    """Return the slopes of the level, across and down per px, over a window around a pixel."""
    across = background_at(mesh, u + radius, v)[0] - background_at(mesh, u - radius, v)[0]
    down = background_at(mesh, u, v + radius)[0] - background_at(mesh, u, v - radius)[0]
    return across / (2 * radius), down / (2 * radius)


@compiled
def _is_bent(level: np.ndarray, noise: float) -> bool:
    """Return whether the level of many tiles is no plane between those around them."""
    count = bent = 0
    for i in range(1, level.shape[0] - 1):
        for j in range(1, level.shape[1] - 1):
            across = abs(level[i, j - 1] - 2 * level[i, j] + level[i, j + 1]) / 8
            down = abs(level[i - 1, j] - 2 * level[i, j] + level[i + 1, j]) / 8
            bent += max(across, down) > BEND_SIGMAS * noise
            count += 1
    return bent > BENT_SHARE * count


@compiled
def has_changed(mesh: Mesh, image: np.ndarray, uv: np.ndarray, noise_dn: float) -> bool:
    """
    Return whether the level around many of the stars near uv (K, 2) px is another one.

    noise_dn is that of a pixel; the level around a star is the median of a ring.
    """
    height, width = image.shape
    changed, middle = 0, len(_RING) // 2
    for i in range(len(uv)):
        u, v = int(uv[i, 0]), int(uv[i, 1])
        if not (RING_PX <= u < width - RING_PX and RING_PX <= v < height - RING_PX):
            continue
        # A slope leaves the median of a ring as it is.
        level, _ = background_at(mesh, u, v)
        darker = not_brighter = 0
        for k in range(len(_RING)):
            value = image[v + _RING[k, 1], u + _RING[k, 0]]
            darker += value < level - CHANGED_SIGMAS * noise_dn
            not_brighter += value <= level + CHANGED_SIGMAS * noise_dn
        changed += darker > middle or not_brighter <= middle
    return changed > CHANGED_SHARE * len(uv)


@compiled
def _measure(image: np.ndarray, kernel: Kernel, rows: int, columns: int
             ) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return level, noise and their medians from SAMPLE_ROWS x SAMPLES pixels of each tile."""
    samples = _sample(image, kernel, rows, columns)
    tiles = samples.reshape(rows, columns, SAMPLE_ROWS * SAMPLES)
    level, noise = np.empty((rows + 2, columns + 2)), np.empty((rows + 2, columns + 2))
    for i in range(rows):
        for j in range(columns):
            level[i + 1, j + 1] = order_statistic(tiles[i, j], tiles.shape[2] // 2) / STEPS_PER_DN
    _extend(level)
    _subtract_level(level, samples)
    scatter = _scatter(tiles)
    for i in range(rows):
        for j in range(columns):
            noise[i + 1, j + 1] = max(_median_of_nine(scatter, i, j),
                                      kernel.noise_gain * QUANTISATION_DN)
    noise[1:-1, 1:-1] *= _tail_ratio(tiles, noise)
    _extend(noise)
    return level, noise, np.median(level[1:-1, 1:-1]), np.median(noise[1:-1, 1:-1])


@compiled
def _sample(image: np.ndarray, kernel: Kernel, rows: int, columns: int) -> np.ndarray:
    """Return samples (rows, columns, SAMPLE_ROWS, SAMPLES) int32 of the smoothed image."""
    height, width = image.shape
    radius, count = len(kernel.weights) - 1, columns * SAMPLES
    down, line = np.empty(width + 2 * radius, np.float32), np.empty(width, np.float32)
    u = ((np.arange(count) + 0.5) * width / count).astype(np.uintp)
    samples = np.empty((rows, columns, SAMPLE_ROWS, SAMPLES), np.int32)
    for i in range(rows):
        for k in range(SAMPLE_ROWS):
            v = int((i + (k + 0.5) / SAMPLE_ROWS) * height / rows)
            filter_down(image, kernel.weights, v, height, down)
            filter_across(down, kernel.weights, 0, width, line)
            for j in range(columns):
                for m in range(SAMPLES):
                    samples[i, j, k, m] = np.int32(line[u[j * SAMPLES + m]] * STEPS_PER_DN)
    return samples


@compiled
def _subtract_level(level: np.ndarray, samples: np.ndarray) -> None:
    """Subtract the level, linear between the middles of the tiles, from samples as int32."""
    rows, columns = samples.shape[:2]
    at_tile = np.empty(columns + 2)
    for i in range(rows):
        for k in range(SAMPLE_ROWS):
            interpolate_row(level, i + 0.5 + (k + 0.5) / SAMPLE_ROWS, at_tile)
            for j in range(columns):
                middle = np.float32(STEPS_PER_DN * at_tile[j + 1])
                before = np.float32(STEPS_PER_DN * (at_tile[j + 1] - at_tile[j]))
                after = np.float32(STEPS_PER_DN * (at_tile[j + 2] - at_tile[j + 1]))
                row = samples[i, j, k]
                for m in range(SAMPLES):
                    row[m] -= np.int32(middle + _BEFORE_MIDDLE[m] * before
                                       + _AFTER_MIDDLE[m] * after)


@compiled
def _scatter(tiles: np.ndarray) -> np.ndarray:
    """Return the scaled MAD (rows, columns) in DN of samples (rows, columns, N) without level."""
    rows, columns, count = tiles.shape
    scatter, deviation = np.empty((rows, columns)), np.empty(count, np.int32)
    for i in range(rows):
        for j in range(columns):
            for k in range(count):
                deviation[k] = abs(tiles[i, j, k])
            scatter[i, j] = (SIGMA_PER_MAD * order_statistic(deviation, count // 2)
                             / STEPS_PER_DN)
    return scatter


@compiled
def order_statistic(values: np.ndarray, rank: int) -> int:
    """
    Return the value of this rank, from 0, among values (N,) int32.

    Bisection by counting, which unlike a partition has no branches that depend on the data.
    """
    low, high = values[0], values[0]
    for k in range(1, len(values)):
        low, high = min(low, values[k]), max(high, values[k])
    while low < high:
        middle = np.int32((low + high) >> 1)
        # In int64, the default of sums, it would take twice the time.
        count = np.int32(0)
        for k in range(len(values)):
            count = np.int32(count + (values[k] <= middle))
        if count > rank:
            high = middle
        else:
            low = np.int32(middle + 1)
    return low


@compiled
def _median_of_nine(mesh: np.ndarray, i: int, j: int) -> float:
    """Return the median of a tile and the eight around it, those of the border repeated."""
    around = np.empty(9)
    for k in range(9):
        value = mesh[min(max(i + k // 3 - 1, 0), mesh.shape[0] - 1),
                     min(max(j + k % 3 - 1, 0), mesh.shape[1] - 1)]
        insert_sorted(around, k, value)
    return around[4]


@compiled
def _tail_ratio(tiles: np.ndarray, noise: np.ndarray) -> float:
    """Return the ratio of the upper tail of samples (rows, columns, N) to that of a normal."""
    rows, columns, count = tiles.shape
    step = max(1, tiles.size // TAIL_SAMPLES)
    tail = np.empty((rows, columns, (count + step - 1) // step), np.int32)
    for i in range(rows):
        for j in range(columns):
            for k in range(tail.shape[2]):
                sigmas = tiles[i, j, k * step] / (noise[i + 1, j + 1] * STEPS_PER_DN)
                tail[i, j, k] = np.int32(min(sigmas, MAX_SIGMAS) * STEPS_PER_DN)
    rank = int(TAIL_QUANTILE * tail.size)
    ratio = order_statistic(tail.ravel(), rank) / STEPS_PER_DN / TAIL_SIGMAS
    return min(max(ratio, 1.0), MAX_TAIL_RATIO)


@compiled
def _extend(mesh: np.ndarray) -> None:
    """Extrapolate the inner tiles linearly into the border; a single tile stays flat."""
    rows, columns = mesh.shape[0] - 2, mesh.shape[1] - 2
    for j in range(1, columns + 1):
        mesh[0, j] = 2 * mesh[1, j] - mesh[min(2, rows), j]
        mesh[rows + 1, j] = 2 * mesh[rows, j] - mesh[max(rows - 1, 1), j]
    for i in range(rows + 2):
        mesh[i, 0] = 2 * mesh[i, 1] - mesh[i, min(2, columns)]
        mesh[i, columns + 1] = 2 * mesh[i, columns] - mesh[i, max(columns - 1, 1)]
