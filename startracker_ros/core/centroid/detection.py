# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Detection of stars as peaks of the smoothed image, and the full scale of the camera."""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.centroid.background import background_at, interpolate_row, Mesh
from startracker_ros.core.centroid.smoothing import filter_across, filter_down, filtered_at, Kernel
from startracker_ros.core.compiled import compiled

PX_PER_PEAK = 400  # of more peaks than one in so many pixels the highest are listed
FEW_PEAKS = 100  # all of which are listed
_PX_PER_MAXIMUM = 4  # at least: no two local maxima are neighbours
ROUNDING = 1e-6  # relative, of a mean in float32
PLATEAU_DN = 64  # a flat top lower than this may be rounding, not saturation
RING_SIGMAS = 4.0  # radius of a ring around a peak
RING_LIGHT = 0.5  # share of the height of a peak from which on the ring is bright
STAR, DISC, LINE = range(3)  # what a peak belongs to
_ANGLES = np.arange(8) * np.pi / 4
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


class Threshold(NamedTuple):
    """Height of a peak above the background: `sigmas` of the noise, and no less than dn."""

    sigmas: float
    dn: float

    @property
    def text(self) -> str:
        """Return the threshold with its unit."""
        return f'{self.dn:.1f} DN' if self.dn > 0 else f'{self.sigmas:g} sigma'


class Peaks(NamedTuple):
    """
    K peaks, highest first: uv (K, 2) int; height, level, noise (K,) of the smoothed image.

    height and level in DN, the height above the level; noise 1 sigma in DN. top (K, 2) px is
    the offset from uv to the top of a parabola through the peak and its neighbours.
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
    Result of a search: peaks; found, the number of all peaks, listed or not.

    discs (D, 2) and lines (L, 2) are pixels u, v of peaks left out: they belong to something
    large, such as the Moon, or to a line, such as a trail or a saturated column. row_max (H,)
    are the brightest pixels of the rows.
    """

    peaks: Peaks
    found: int
    discs: np.ndarray
    lines: np.ndarray
    row_max: np.ndarray

    @property
    def too_many(self) -> bool:
        """Whether there are more peaks than are listed: noise, a pattern, or a dense field."""
        return self.found > len(self.peaks.uv)


class _Rows(NamedTuple):
    """
    Ring buffers of a search down the image, float32; row v is at v modulo their length.

    image (2 r + 1, W); down (3, W + 2 r): filtered along the columns, r px longer on each side.
    smooth (3, W) is no ring: rows v - 1, v, v + 1 filtered along both axes, where needed.
    """

    image: np.ndarray
    down: np.ndarray
    smooth: np.ndarray


class _Limits(NamedTuple):
    """
    Detection threshold, in DN of the smoothed image.

    mesh (rows + 2, columns + 2) has a value per tile. at_tile (N,), N = columns + 2, are its
    values in one row, at the middles of the tiles. Segment j of a row, of the N - 1, is
    between the middles of tiles j and j + 1, where the threshold is a straight line: pixels
    begin[j] to begin[j + 1] - 1. margin is the median height of the threshold above the level.
    """

    mesh: np.ndarray
    at_tile: np.ndarray
    begin: np.ndarray
    margin: float


def find_peaks(image: np.ndarray, kernel: Kernel, mesh: Mesh, threshold: Threshold) -> Search:
    """
    Return the local maxima of image (H, W) after smoothing that exceed the threshold.

    Of more than one in PX_PER_PEAK the highest are listed. Peaks within or on the rim of something
    bright and large, such as the Moon, and peaks along a line are left out: their noise would
    otherwise make more peaks than the sky has stars.
    """
    ring = np.rint(RING_SIGMAS * kernel.sigma_px * _DIRECTIONS).astype(np.int64)
    max_peaks = max(FEW_PEAKS, image.size // PX_PER_PEAK)
    peaks, no_stars, counts, row_max = _search(
        image, kernel, mesh, threshold, ring, max(FEW_PEAKS, image.size // _PX_PER_MAXIMUM))
    order = np.argsort(-peaks.height[:counts[STAR]], kind='stable')[:max_peaks]
    return Search(peaks.select(order), int(counts[STAR]), no_stars[0, :counts[DISC]],
                  no_stars[1, :counts[LINE]], row_max)


@compiled
def _search(image: np.ndarray, kernel: Kernel, mesh: Mesh, threshold: Threshold,
            ring: np.ndarray, max_peaks: int
            ) -> tuple[Peaks, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the peaks in the order of the image, the pixels of discs and lines, and row_max.

    The pixels (2, max_peaks, 2) of discs and of lines are filled up to the counts (3,) of STAR,
    DISC and LINE; that of STAR goes on beyond max_peaks.
    """
    height, width = image.shape
    weights, radius = kernel.weights, len(kernel.weights) - 1
    rows, limits = _empty_rows(width, radius), _limits(mesh, threshold, width)
    peaks, row_max = empty_peaks(max_peaks), np.empty(height, image.dtype)
    no_stars, counts = np.empty((2, max_peaks, 2), np.int64), np.zeros(3, np.int64)
    segments, maxima = np.empty(len(limits.begin) - 1, np.int64), np.empty(width, np.int64)
    upper, middle, lower = rows.smooth[0], rows.smooth[1], rows.smooth[2]
    for below in range(-radius, height):
        if below + radius < height:
            row_max[below + radius] = _load_row(image, below + radius, rows.image)
        if below >= 0:
            filter_down(rows.image, weights, below, height, rows.down[below % 3])
        if below < 2:
            continue
        v = below - 1
        interpolate_row(limits.mesh, (v + 0.5) * mesh.scale[0] + 0.5, limits.at_tile)
        above, line, under = rows.down[(v - 1) % 3], rows.down[v % 3], rows.down[below % 3]
        for k in range(_find_segments(line, kernel, limits, segments)):
            first, end = limits.begin[segments[k]], limits.begin[segments[k] + 1]
            filter_across(line, weights, first - 1, end + 1, middle)
            if not _reaches(middle, first, end, _lowest(limits, segments[k])):
                continue
            filter_across(above, weights, first - 1, end + 1, upper)
            filter_across(under, weights, first - 1, end + 1, lower)
            for m in range(_find_maxima(rows.smooth, limits, segments[k], mesh.scale[1], maxima)):
                kind = _measure_peak(image, kernel, mesh, rows.smooth, ring, maxima[m], v,
                                     counts[STAR], peaks)
                if kind != STAR and counts[kind] < max_peaks:
                    no_stars[kind - 1, counts[kind], 0] = maxima[m]
                    no_stars[kind - 1, counts[kind], 1] = v
                    counts[kind] += 1
                counts[STAR] += kind == STAR
    return peaks, no_stars, counts, row_max


@compiled
def _measure_peak(image: np.ndarray, kernel: Kernel, mesh: Mesh, smooth: np.ndarray,
                  ring: np.ndarray, u: int, v: int, slot: int, peaks: Peaks) -> int:
    """Return what the peak at pixel u, v belongs to; if to a star, put it into a slot."""
    level, noise = background_at(mesh, u, v)
    height = smooth[1, u] - level
    kind = _kind(image, kernel, u, v, level + RING_LIGHT * height, ring)
    if kind == STAR and slot < len(peaks.height):
        peaks.uv[slot, 0], peaks.uv[slot, 1] = u, v
        peaks.top[slot, 0] = parabola_top(smooth[1, u - 1], smooth[1, u], smooth[1, u + 1])
        peaks.top[slot, 1] = parabola_top(smooth[0, u], smooth[1, u], smooth[2, u])
        peaks.height[slot], peaks.level[slot], peaks.noise[slot] = height, level, noise
    return kind


@compiled
def empty_peaks(count: int) -> Peaks:
    """Return a list of so many peaks, to be filled."""
    return Peaks(np.empty((count, 2), np.int64), np.empty((count, 2)), np.empty(count),
                 np.empty(count), np.empty(count))


@compiled
def _empty_rows(width: int, radius: int) -> _Rows:
    return _Rows(np.empty((2 * radius + 1, width), np.float32),
                 np.empty((3, width + 2 * radius), np.float32),
                 np.empty((3, width), np.float32))


@compiled
def _limits(mesh: Mesh, threshold: Threshold, width: int) -> _Limits:
    """Return the detection threshold of an image of this width; at_tile is not filled yet."""
    tiles = mesh.level.shape[1]
    middle = (np.arange(tiles) - 0.5) / mesh.scale[1] - 0.5
    begin = np.ones(tiles, np.int64)
    begin[1:] = np.minimum(np.ceil(middle[1:]), width - 1)
    return _Limits(mesh.level + np.maximum(threshold.sigmas * mesh.noise, threshold.dn),
                   np.empty(tiles), begin,
                   max(threshold.sigmas * mesh.median_noise, threshold.dn))


@compiled
def _load_row(image: np.ndarray, v: int, rows: np.ndarray) -> int:
    """Copy row v of image into the ring buffer rows (n, W); return its brightest pixel."""
    line, row = image[v], v % len(rows)
    brightest = line[0]
    for u in range(len(line)):
        rows[row, u] = line[u]
        brightest = max(brightest, line[u])
    return brightest


@compiled
def _find_segments(line: np.ndarray, kernel: Kernel, limits: _Limits, segments: np.ndarray
                   ) -> int:
    """
    Fill segments with those of a row in which a star may be; return their number.

    line is the row filtered along its columns. The filter along the row is a mean of means of
    pairs, with the share P = kernel.pairs, and of single pixels. Where all pixels are below
    T + margin and all means of pairs below T - margin (1 - P) / P, T the lower end of the
    threshold in the segment, the filtered row is below T: it need not be computed.
    """
    count, at_tile, begin = len(limits.begin) - 1, limits.at_tile, limits.begin
    reach, margin, chosen = 2 * (len(kernel.weights) - 1), limits.margin, 0
    below = margin * (1 - kernel.pairs) / kernel.pairs
    lowest = at_tile[0]
    for j in range(count):
        lowest = min(lowest, at_tile[j + 1])
    # Most rows of a dark sky end here.
    if not _may_reach(line, begin[0], begin[count] + reach, lowest, margin, below):
        return 0
    for j in range(count):
        segments[chosen] = j
        chosen += _may_reach(line, begin[j], begin[j + 1] + reach,
                             min(at_tile[j], at_tile[j + 1]), margin, below)
    return chosen


@compiled
def _may_reach(line: np.ndarray, begin: int, end: int, least: float, margin: float, below: float
               ) -> bool:
    """
    Return whether in line[begin:end] a pixel reaches least + margin, a pair least - below.

    A pair is the mean of two neighbours. One comparison does both: a pixel is added to its
    neighbour, which counts as no less than what a pixel of least + margin needs beside it.
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
def _lowest(limits: _Limits, j: int) -> np.float32:
    """Return the lower end of the threshold in segment j."""
    return np.float32(min(limits.at_tile[j], limits.at_tile[j + 1]))


@compiled
def _reaches(line: np.ndarray, begin: int, end: int, lowest: np.float32) -> bool:
    """Return whether one of line[begin:end] is at least lowest."""
    reached = False
    for k in range(np.uintp(begin), np.uintp(end)):
        reached |= line[k] >= lowest
    return reached


@compiled
def _find_maxima(smooth: np.ndarray, limits: _Limits, j: int, tiles_per_px: float,
                 maxima: np.ndarray) -> int:
    """Fill maxima with the columns of the peaks in segment j of a row; return their number."""
    count, left, right = 0, limits.at_tile[j], limits.at_tile[j + 1]
    lowest = _lowest(limits, j)
    for u in range(limits.begin[j], limits.begin[j + 1]):
        if smooth[1, u] >= lowest:
            x = (u + 0.5) * tiles_per_px + 0.5 - j
            if smooth[1, u] > (1 - x) * left + x * right and _is_maximum(smooth, u):
                maxima[count] = u
                count += 1
    return count


@compiled
def _is_maximum(smooth: np.ndarray, u: int) -> bool:
    """
    Return whether the middle one of the rows (3, W) has a local maximum at u.

    It exceeds the four neighbours before it and does not fall below the four after it, so that
    a flat top gives one peak.
    """
    here = smooth[1, u]
    return (here > smooth[1, u - 1] and here >= smooth[1, u + 1]
            and here > smooth[0, u - 1] and here > smooth[0, u] and here > smooth[0, u + 1]
            and here >= smooth[2, u - 1] and here >= smooth[2, u] and here >= smooth[2, u + 1])


@compiled
def parabola_top(before: float, here: float, after: float) -> float:
    """Return the top, between -0.5 and 0.5, of a parabola through values at -1, 0 and 1."""
    bend = max(2 * here - before - after, 1e-6)
    return min(max((after - before) / (2 * bend), -0.5), 0.5)


@compiled
def _kind(image: np.ndarray, kernel: Kernel, u: int, v: int, limit: float, ring: np.ndarray
          ) -> int:
    """
    Return what a peak belongs to, by a ring of the filtered image around it.

    A DISC has half of the ring or more above the limit, a LINE two opposite directions.
    """
    bright, opposite, half = 0, False, len(ring) // 2
    for k in range(half):
        here = _exceeds(image, kernel, u + ring[k, 0], v + ring[k, 1], limit)
        across = _exceeds(image, kernel, u - ring[k, 0], v - ring[k, 1], limit)
        opposite |= here and across
        bright += here + across
    if bright >= half:
        return DISC
    return LINE if opposite else STAR


@compiled
def _exceeds(image: np.ndarray, kernel: Kernel, u: int, v: int, limit: float) -> bool:
    """Return whether the filtered image exceeds the limit at the pixel in it next to u, v."""
    return filtered_at(image, kernel.weights, min(max(u, 0), image.shape[1] - 1),
                       min(max(v, 0), image.shape[0] - 1)) > limit


def full_scale(image: np.ndarray, row_max: np.ndarray, background_dn: float, bits: int) -> float:
    """
    Return the DN at which the image saturates, infinity when nothing in it is saturated.

    row_max (H,) are the brightest pixels of the rows, bits the depth of the pixels. The
    brightest pixel is at full scale when it has the largest value of this depth or of a 10, 12 or
    14 bit camera (in the low or the high bits), or when it belongs to a flat top, as where a
    camera clips at a lower level.
    """
    brightest = int(row_max.max())
    if brightest == 2 ** bits - 1:
        return float(brightest)
    if brightest - background_dn < PLATEAU_DN:
        return np.inf
    depths = (10, 12, 14) if bits == 16 else ()
    if any(brightest in (2 ** depth - 1, (2 ** depth - 1) << (bits - depth))
           for depth in depths):
        return float(brightest)
    return float(brightest) if _flat_top(image, row_max) else np.inf


@compiled
def _flat_top(image: np.ndarray, row_max: np.ndarray) -> bool:
    """Return whether one of the brightest pixels has four as bright beside it."""
    brightest = row_max.max()
    for v in range(1, len(image) - 1):
        if row_max[v - 1] == row_max[v] == row_max[v + 1] == brightest:
            before, here, after = image[v - 1], image[v], image[v + 1]
            for u in range(1, len(here) - 1):
                if (before[u] == brightest and after[u] == brightest
                        and here[u - 1] == here[u] == here[u + 1] == brightest):
                    return True
    return False
