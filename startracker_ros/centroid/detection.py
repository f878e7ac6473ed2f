"""Where stars may be: peaks of the smoothed image, and the full scale of the camera."""

from typing import NamedTuple

import numpy as np
from startracker_ros.centroid.background import across_mesh, background_at, Mesh
from startracker_ros.centroid.smoothing import filter_across, filter_down, filtered_at, Kernel
from startracker_ros.compiled import compiled

ROUNDING = 1e-6  # relative, of a mean in float32
PLATEAU_DN = 64  # a flat top lower than this may be rounding, not saturation
RING_SIGMAS = 4.0  # around a peak it is dark again,
RING_LIGHT = 0.5  # less than this share of the peak in half of the directions
_ANGLES = np.arange(8) * np.pi / 4
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


class Peaks(NamedTuple):
    """
    K peaks, highest first: uv (K, 2) int; height, level, noise (K,) of the smoothed image.

    height and level in DN, the height above the level; noise 1 sigma in DN. top (K, 2) px is
    how far from uv a parabola through the peak and its neighbours has its top.
    """

    uv: np.ndarray
    top: np.ndarray
    height: np.ndarray
    level: np.ndarray
    noise: np.ndarray

    def select(self, chosen: np.ndarray | slice) -> 'Peaks':
        """Return the peaks of a mask (K,), of indices or of a slice."""
        return Peaks(self.uv[chosen], self.top[chosen], self.height[chosen],
                     self.level[chosen], self.noise[chosen])


class Search(NamedTuple):
    """
    What a search found: peaks; the number of all, listed or not, and of those left out.

    tops (H,) are the brightest pixels of the rows.
    """

    peaks: Peaks
    found: int
    discs: int
    tops: np.ndarray


def find_peaks(image: np.ndarray, kernel: Kernel, mesh: Mesh, sigmas: float, least_dn: float,
               most: int) -> Search:
    """
    Return the local maxima of image (H, W) after smoothing.

    A maximum is `sigmas` of noise and least_dn above the background. No more than `most` are
    listed. Left out are those within or on the rim of something bright and large, such as the
    Moon, whose noise would otherwise make more peaks than the sky has stars.
    """
    ring = np.rint(RING_SIGMAS * kernel.sigma_px * _DIRECTIONS).astype(np.int64)
    columns, found, discs, tops = _scan(image, kernel, mesh, sigmas, least_dn, ring, most)
    peaks = Peaks(*columns)
    return Search(peaks.select(np.argsort(-peaks.height, kind='stable')), found, discs, tops)


@compiled
def _scan(image: np.ndarray, kernel: Kernel, mesh: Mesh, sigmas: float, least_dn: float,
          ring: np.ndarray, most: int) -> tuple[tuple[np.ndarray, ...], int, int, np.ndarray]:
    """
    Return the fields of Search, with the peaks in the order of the image.

    A pixel must exceed the four neighbours before it and not fall below the four after
    it, so that a flat top gives one peak. The outermost pixels are no peaks.
    """
    height, width = image.shape
    weights, radius = kernel.weights, len(kernel.weights) - 1
    rows = np.empty((2 * radius + 1, width), np.float32)
    columns = np.empty((3, width + 2 * radius), np.float32)
    smooth = np.empty((3, width), np.float32)
    tops = np.empty(height, image.dtype)
    uv, top = np.empty((most, 2), np.int64), np.empty((most, 2))
    peak_dn, level_dn, noise_dn = np.empty(most), np.empty(most), np.empty(most)
    count = discs = 0
    threshold = mesh.level + np.maximum(sigmas * mesh.noise, least_dn)
    margin = max(sigmas * mesh.median_noise, least_dn)
    node = np.empty(threshold.shape[1])
    middle = (np.arange(len(node)) + 0.5) / mesh.scale[1] - 0.5
    end = np.ones(len(node), np.int64)
    end[1:] = np.minimum(np.ceil(middle[:-1]), width - 1)
    likely = np.empty(len(node), np.int64)
    for v in range(min(radius, height)):
        tops[v] = _take_in(image, v, rows)
    for v in range(height):
        if v + radius < height:
            tops[v + radius] = _take_in(image, v + radius, rows)
        filter_down(rows, weights, v, height, columns[v % 3])
        if v < 2:
            continue
        across_mesh(threshold, (v - 0.5) * mesh.scale[0] + 0.5, node)
        before, line, after = columns[(v - 2) % 3], columns[(v - 1) % 3], columns[v % 3]
        for k in range(_likely_pieces(line, kernel, node, end, margin, likely)):
            j = likely[k]
            lowest = np.float32(min(node[j], node[j + 1]))
            filter_across(line, weights, end[j] - 1, end[j + 1] + 1, smooth[1])
            if not _reaches(smooth[1], end[j], end[j + 1], lowest):
                continue
            filter_across(before, weights, end[j] - 1, end[j + 1] + 1, smooth[0])
            filter_across(after, weights, end[j] - 1, end[j + 1] + 1, smooth[2])
            for u in range(end[j], end[j + 1]):
                here = smooth[1, u]
                if here < lowest:
                    continue
                x = (u + 0.5) * mesh.scale[1] + 0.5 - j
                if here > (1 - x) * node[j] + x * node[j + 1] and _is_top(smooth, u):
                    level, noise = background_at(mesh, u, v - 1)
                    if not _alone(image, kernel, u, v - 1, here - level, level, ring):
                        discs += 1
                        continue
                    if count < most:
                        uv[count] = u, v - 1
                        top[count, 0] = _parabola(smooth[1, u - 1], here, smooth[1, u + 1])
                        top[count, 1] = _parabola(smooth[0, u], here, smooth[2, u])
                        peak_dn[count], level_dn[count] = here - level, level
                        noise_dn[count] = noise
                    count += 1
    listed = min(count, most)
    return ((uv[:listed], top[:listed], peak_dn[:listed], level_dn[:listed], noise_dn[:listed]),
            count, discs, tops)


@compiled
def _take_in(image: np.ndarray, v: int, rows: np.ndarray) -> int:
    """Put row v of image into rows; return its brightest pixel."""
    line, place = image[v], v % len(rows)
    top = line[0]
    for u in range(len(line)):
        rows[place, u] = line[u]
        top = max(top, line[u])
    return top


@compiled
def _likely_pieces(line: np.ndarray, kernel: Kernel, node: np.ndarray, end: np.ndarray,
                   margin: float, likely: np.ndarray) -> int:
    """
    Fill likely with those pieces j of a row in which a star may be; return their number.

    line is the row filtered along its columns. Piece j goes from end[j] to end[j + 1], between
    the middles of two tiles, where the threshold is a straight line from node[j] to
    node[j + 1]: where no pixel reaches the lower end, none needs a second look. The filter
    along the row is a mean of means of pairs, and of few single pixels: where no single pixel
    is a margin above the threshold and no pair is above what this margin makes good, it need
    not be applied.
    """
    pieces, reach, count = len(node) - 1, 2 * (len(kernel.weights) - 1), 0
    below = margin * (1 - kernel.pairs) / kernel.pairs
    least = node[0]
    for j in range(pieces):
        least = min(least, node[j + 1])
    # Most rows of a dark sky are through at once.
    if not _may_reach(line, end[0], end[pieces] + reach, least, margin, below):
        return 0
    for j in range(pieces):
        likely[count] = j
        count += _may_reach(line, end[j], end[j + 1] + reach, min(node[j], node[j + 1]), margin,
                            below)
    return count


@compiled
def _may_reach(line: np.ndarray, begin: int, end: int, least: float, margin: float, below: float
               ) -> bool:
    """
    Return whether in line[begin:end] a pixel reaches least + margin, or a pair least - below.

    It is one comparison: a pixel that reaches its limit makes up for any that is beside it.
    """
    least -= ROUNDING * abs(least)
    pair = np.float32(2 * (least - below))
    beside = np.float32(pair - (least + margin))
    first, last = np.uintp(begin), np.uintp(end - 1)
    reached = line[last] + beside >= pair
    for k in range(first, last):
        following = line[k + np.uintp(1)]
        reached |= line[k] + (following if following > beside else beside) >= pair
    return reached


@compiled
def _reaches(line: np.ndarray, begin: int, end: int, lowest: np.float32) -> bool:
    """Return whether one of line[begin:end] is at least lowest."""
    reached = False
    for k in range(np.uintp(begin), np.uintp(end)):
        reached |= line[k] >= lowest
    return reached


@compiled
def _is_top(smooth: np.ndarray, u: int) -> bool:
    """Return whether the middle one of the rows (3, W) has its highest value at u."""
    here = smooth[1, u]
    return (here > smooth[1, u - 1] and here >= smooth[1, u + 1]
            and here > smooth[0, u - 1] and here > smooth[0, u] and here > smooth[0, u + 1]
            and here >= smooth[2, u - 1] and here >= smooth[2, u] and here >= smooth[2, u + 1])


@compiled
def _parabola(before: float, here: float, after: float) -> float:
    """Return where between -0.5 and 0.5 a parabola through three values has its top."""
    bend = max(2 * here - before - after, 1e-6)
    return min(max((after - before) / (2 * bend), -0.5), 0.5)


@compiled
def _alone(image: np.ndarray, kernel: Kernel, u: int, v: int, peak_dn: float, level: float,
           ring: np.ndarray) -> bool:
    """Return whether it is dark around a peak in half of the directions."""
    around, dark, half = np.empty(len(ring)), 0, len(ring) // 2
    limit = level + RING_LIGHT * peak_dn
    for k in range(len(ring)):
        around[k] = filtered_at(image, kernel.weights,
                                min(max(u + ring[k, 0], 0), image.shape[1] - 1),
                                min(max(v + ring[k, 1], 0), image.shape[0] - 1))
        dark += around[k] < limit
        # The rest cannot change the median any more: it is the mean of the two in the middle.
        if dark > half or k - dark >= half:
            return dark > half
    return bool(np.median(around) < limit)


def full_scale(image: np.ndarray, tops: np.ndarray, background_dn: float) -> float:
    """
    Return the DN at which the image saturates, infinity when nothing in it is saturated.

    tops (H,) are the maxima of the rows.

    The brightest pixel is at full scale when it has the largest value of the type or of a
    10, 12 or 14 bit camera (in the low or the high bits), or when it belongs to a flat top,
    as it does where a camera clips at a level of its own.
    """
    brightest, bits = int(tops.max()), 8 * image.dtype.itemsize
    if brightest == 2 ** bits - 1:
        return float(brightest)
    if brightest - background_dn < PLATEAU_DN:
        return np.inf
    depths = (10, 12, 14) if bits == 16 else ()
    if any(brightest in (2 ** depth - 1, (2 ** depth - 1) << (bits - depth))
           for depth in depths):
        return float(brightest)
    return float(brightest) if _flat_top(image, tops) else np.inf


@compiled
def _flat_top(image: np.ndarray, tops: np.ndarray) -> bool:
    """Return whether a brightest pixel has four as bright beside it."""
    brightest = tops.max()
    for v in range(1, len(image) - 1):
        if tops[v - 1] == tops[v] == tops[v + 1] == brightest:
            before, here, after = image[v - 1], image[v], image[v + 1]
            for u in range(1, len(here) - 1):
                if (before[u] == brightest and after[u] == brightest
                        and here[u - 1] == here[u] == here[u + 1] == brightest):
                    return True
    return False
