"""Local background and noise on a coarse mesh, measured in the smoothed image."""

from typing import NamedTuple

import numpy as np
from startracker_ros.centroid.smoothing import filter_across, filter_down, Kernel
from startracker_ros.compiled import compiled

TILE_PX = 64
SAMPLE_ROWS = 8  # of a tile; each has to be filtered,
SAMPLES = 16  # the pixels along it are then cheap
QUANTISATION_DN = 12 ** -0.5  # standard deviation of rounding to whole DN
SIGMA_OF_MAD = 1.4826  # of a normal distribution
TAIL = 0.95  # the quantile that shows a skewed noise and is not yet made of stars
TAIL_SIGMAS = 1.6449  # of a normal distribution
TAIL_SAMPLES = 16384
MOST_SIGMAS = 100.0  # more are as far beyond the tail
MAX_TAIL = 1.5  # beyond this it is stars after all
FINE = 256  # steps of one DN, in which samples are ranked as int32
_FROM_MIDDLE = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5).astype(np.float32)  # of a tile
_BEFORE_MIDDLE, _AFTER_MIDDLE = _FROM_MIDDLE.clip(max=0), _FROM_MIDDLE.clip(min=0)


class Mesh(NamedTuple):
    """
    Background of an image; level and noise (rows + 2, columns + 2) have a value per tile.

    A tile more on each side continues them straight. level in DN; noise, 1 sigma in DN, is
    that of the smoothed image. The medians are of the tiles within. scale holds tiles per
    pixel, down and across.
    """

    level: np.ndarray
    noise: np.ndarray
    median_level: float
    median_noise: float
    scale: tuple[float, float]


def measure_background(image: np.ndarray, kernel: Kernel) -> Mesh:
    """
    Return the mesh of image (H, W) after smoothing: median and scaled MAD of each tile.

    The smoothed image is measured because averaging undoes the quantisation that makes the
    MAD of an 8-bit image 0 or 1, and because correlated noise then counts as what it does to
    a star.
    Where the noise is skewed, as in a camera whose background is cut off at zero, the MAD
    is scaled up to the upper tail, which is where false stars come from.
    """
    height, width = image.shape
    rows, columns = max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX))
    return Mesh(*_measure(image, kernel, rows, columns),
                (rows / height, columns / width))


@compiled
def interpolate(mesh: np.ndarray, y: float, x: float) -> float:
    """Return the value at y tiles down and x tiles across, bilinear."""
    i = min(max(int(y), 0), mesh.shape[0] - 2)
    j = min(max(int(x), 0), mesh.shape[1] - 2)
    y, x = y - i, x - j
    return ((1 - y) * ((1 - x) * mesh[i, j] + x * mesh[i, j + 1])
            + y * ((1 - x) * mesh[i + 1, j] + x * mesh[i + 1, j + 1]))


@compiled
def across_mesh(mesh: np.ndarray, y: float, node: np.ndarray) -> None:
    """Fill node (columns,) with the values at y tiles down, in the middles of the tiles."""
    i = min(max(int(y), 0), mesh.shape[0] - 2)
    for j in range(len(node)):
        node[j] = (i + 1 - y) * mesh[i, j] + (y - i) * mesh[i + 1, j]


@compiled
def background_at(mesh: Mesh, u: int, v: int) -> tuple[float, float]:
    """Return level and noise at a pixel."""
    y, x = (v + 0.5) * mesh.scale[0] + 0.5, (u + 0.5) * mesh.scale[1] + 0.5
    return interpolate(mesh.level, y, x), interpolate(mesh.noise, y, x)


@compiled
def _measure(image: np.ndarray, kernel: Kernel, rows: int, columns: int
             ) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return level, noise and their medians from SAMPLE_ROWS x SAMPLES pixels of each tile."""
    height, width = image.shape
    radius, side, count = len(kernel.weights) - 1, SAMPLES, SAMPLE_ROWS * SAMPLES
    work, line = np.empty(width + 2 * radius, np.float32), np.empty(width, np.float32)
    down = (np.arange(SAMPLE_ROWS) + 0.5) / SAMPLE_ROWS
    across = ((np.arange(columns * side) + 0.5) * width / (columns * side)).astype(np.uintp)
    samples = np.empty((rows, columns * SAMPLE_ROWS, side), np.int32)
    level = np.empty((rows + 2, columns + 2))
    for i in range(rows):
        for k in range(SAMPLE_ROWS):
            v = int((i + down[k]) * height / rows)
            filter_down(image, kernel.weights, v, height, work)
            filter_across(work, kernel.weights, 0, width, line)
            for j in range(columns):
                row = samples[i, j * SAMPLE_ROWS + k]
                for m in range(side):
                    row[m] = np.int32(line[across[j * side + m]] * FINE)
    tiles = samples.reshape(rows, columns, count)
    for i in range(rows):
        for j in range(columns):
            level[i + 1, j + 1] = ranked(tiles[i, j], count // 2) / FINE
    _extend(level)
    spread, deviation = np.empty((rows, columns)), np.empty(count, np.int32)
    node = np.empty(columns + 2)
    for i in range(rows):
        for k in range(SAMPLE_ROWS):
            across_mesh(level, i + 0.5 + down[k], node)
            for j in range(columns):
                _subtract(node, j, samples[i, j * SAMPLE_ROWS + k])
        for j in range(columns):
            for k in range(count):
                deviation[k] = abs(tiles[i, j, k])
            spread[i, j] = SIGMA_OF_MAD * ranked(deviation, count // 2) / FINE
    noise = np.empty((rows + 2, columns + 2))
    for i in range(rows):
        for j in range(columns):
            noise[i + 1, j + 1] = max(_median_around(spread, i, j),
                                      kernel.noise_gain * QUANTISATION_DN)
    noise[1:-1, 1:-1] *= _tail(tiles, noise)
    _extend(noise)
    return level, noise, np.median(level[1:-1, 1:-1]), np.median(noise[1:-1, 1:-1])


@compiled
def _subtract(node: np.ndarray, j: int, row: np.ndarray) -> None:
    """
    Take the level off a row of samples (SAMPLES,) of tile j, whose middle is at node j + 1.

    It is one straight line to the middle of the tile, and another one from there on.
    """
    level = np.float32(FINE * node[j + 1])
    before = np.float32(FINE * (node[j + 1] - node[j]))
    after = np.float32(FINE * (node[j + 2] - node[j + 1]))
    for m in range(SAMPLES):
        row[m] -= np.int32(level + _BEFORE_MIDDLE[m] * before + _AFTER_MIDDLE[m] * after)


@compiled
def ranked(values: np.ndarray, rank: int) -> int:
    """
    Return the value (int) that has so many smaller or equal ones before it, of (N,) int32.

    Bisection by counting, which unlike a partition has no branches that depend on the data.
    """
    low, high = values[0], values[0]
    for k in range(1, len(values)):
        low, high = min(low, values[k]), max(high, values[k])
    while low < high:
        middle = np.int32((low + high) >> 1)
        # In int64, which sums become of themselves, it would take twice the time.
        count = np.int32(0)
        for k in range(len(values)):
            count = np.int32(count + (values[k] <= middle))
        if count > rank:
            high = middle
        else:
            low = np.int32(middle + 1)
    return low


@compiled
def _median_around(mesh: np.ndarray, i: int, j: int) -> float:
    """Return the median of a tile and the eight around it, those of the border repeated."""
    around = np.empty(9)
    for k in range(9):
        value = mesh[min(max(i + k // 3 - 1, 0), mesh.shape[0] - 1),
                     min(max(j + k % 3 - 1, 0), mesh.shape[1] - 1)]
        place = k
        while place > 0 and around[place - 1] > value:
            around[place] = around[place - 1]
            place -= 1
        around[place] = value
    return around[4]


@compiled
def _tail(samples: np.ndarray, noise: np.ndarray) -> float:
    """Return by how much the upper tail of samples (rows, columns, N) exceeds that of a normal."""
    rows, columns, count = samples.shape
    step = max(1, samples.size // TAIL_SAMPLES)
    tail = np.empty((rows, columns, (count + step - 1) // step), np.int32)
    for i in range(rows):
        for j in range(columns):
            for k in range(tail.shape[2]):
                sigmas = samples[i, j, k * step] / (noise[i + 1, j + 1] * FINE)
                tail[i, j, k] = np.int32(min(sigmas, MOST_SIGMAS) * FINE)
    ratio = ranked(tail.ravel(), int(TAIL * tail.size)) / FINE / TAIL_SIGMAS
    return min(max(ratio, 1.0), MAX_TAIL)


@compiled
def _extend(mesh: np.ndarray) -> None:
    """Continue the inner tiles straight into the border; a lone tile stays flat."""
    rows, columns = mesh.shape[0] - 2, mesh.shape[1] - 2
    for j in range(1, columns + 1):
        mesh[0, j] = 2 * mesh[1, j] - mesh[min(2, rows), j]
        mesh[rows + 1, j] = 2 * mesh[rows, j] - mesh[max(rows - 1, 1), j]
    for i in range(rows + 2):
        mesh[i, 0] = 2 * mesh[i, 1] - mesh[i, min(2, columns)]
        mesh[i, columns + 1] = 2 * mesh[i, columns] - mesh[i, max(columns - 1, 1)]
