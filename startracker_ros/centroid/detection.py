"""Where stars may be: peaks of the smoothed image, and the full scale of the camera."""

from typing import NamedTuple

import numpy as np

from startracker_ros.centroid.background import background_at, Mesh
from startracker_ros.centroid.smoothing import filter_row, filtered_at, Kernel
from startracker_ros.compiled import compiled

PLATEAU_DN = 64  # a flat top lower than this may be rounding, not saturation
RING_SIGMAS = 4.0  # around a peak it is dark again,
RING_LIGHT = 0.5  # less than this share of the peak in half of the directions
_ANGLES = np.arange(8) * np.pi / 4
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


class Peaks(NamedTuple):
    """K peaks, highest first: uv (K, 2) int; height, level, noise (K,) of the smoothed image.

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


def find_peaks(image: np.ndarray, kernel: Kernel, mesh: Mesh, sigmas: float, least_dn: float,
               most: int) -> tuple[Peaks, int, int]:
    """Return the local maxima of image (H, W) after smoothing, their number, those left out.

    A maximum is `sigmas` of noise and least_dn above the background. No more than `most` are
    listed. Left out are those within or on the rim of something bright and large, such as the
    Moon, whose noise would otherwise make more peaks than the sky has stars.
    """
    ring = np.rint(RING_SIGMAS * kernel.sigma_px * _DIRECTIONS).astype(np.int64)
    *columns, count, discs = _scan(image, kernel, mesh, sigmas, least_dn, ring, most)
    peaks = Peaks(*columns)
    return peaks.select(np.argsort(-peaks.height, kind='stable')), count, discs


@compiled
def _scan(image, kernel, mesh, sigmas, least_dn, ring, most):
    """Return the columns of Peaks in the order of the image, the number found, those left out.

    A pixel must exceed the four neighbours before it and not fall below the four after
    it, so that a flat top gives one peak. The outermost pixels are no peaks.
    """
    height, width = image.shape
    radius = len(kernel.weights) - 1
    work, smooth = np.empty(width + 2 * radius, np.float32), np.empty((3, width), np.float32)
    for v in range(2):
        filter_row(image, kernel.weights, v, work, smooth[v])
    uv, top = np.empty((most, 2), np.int64), np.empty((most, 2))
    peak_dn, level_dn, noise_dn = np.empty(most), np.empty(most), np.empty(most)
    count = discs = 0
    threshold = mesh.level + np.maximum(sigmas * mesh.noise, least_dn)
    node = np.empty(threshold.shape[1])
    middle = (np.arange(len(node)) + 0.5) / mesh.scale[1] - 0.5
    last = np.minimum(np.ceil(middle), width - 1).astype(np.int64)
    for v in range(1, height - 1):
        before, line, after = smooth[(v - 1) % 3], smooth[v % 3], smooth[(v + 1) % 3]
        filter_row(image, kernel.weights, v + 1, work, after)
        y = (v + 0.5) * mesh.scale[0] + 0.5
        tile = min(int(y), len(threshold) - 2)
        for j in range(len(node)):
            node[j] = ((tile + 1 - y) * threshold[tile, j] + (y - tile) * threshold[tile + 1, j])
        begin = 1
        for j in range(len(node) - 1):
            # Between the middles of two tiles the threshold is a straight line: where no pixel
            # reaches its lower end, none needs a second look.
            end, lowest = last[j], np.float32(min(node[j], node[j + 1]))
            piece, any_above = line[begin:end], False
            for k in range(len(piece)):
                any_above |= piece[k] >= lowest
            if any_above:
                for u in range(begin, end):
                    x = (u + 0.5) * mesh.scale[1] + 0.5 - j
                    here = line[u]
                    if (here > (1 - x) * node[j] + x * node[j + 1]
                            and here > line[u - 1] and here >= line[u + 1]
                            and _is_top(before, after, u, here)):
                        level, noise = background_at(mesh, u, v)
                        if not _alone(image, kernel, u, v, here - level, level, ring):
                            discs += 1
                            continue
                        if count < most:
                            uv[count] = u, v
                            top[count, 0] = _parabola(line[u - 1], here, line[u + 1])
                            top[count, 1] = _parabola(before[u], here, after[u])
                            peak_dn[count], level_dn[count] = here - level, level
                            noise_dn[count] = noise
                        count += 1
            begin = max(begin, end)
    listed = min(count, most)
    return (uv[:listed], top[:listed], peak_dn[:listed], level_dn[:listed], noise_dn[:listed],
            count, discs)


@compiled
def _is_top(before, after, u, here):
    """Return whether the rows before and after have nothing higher beside u."""
    return (here > before[u - 1] and here > before[u] and here > before[u + 1]
            and here >= after[u - 1] and here >= after[u] and here >= after[u + 1])


@compiled
def _parabola(before, here, after):
    """Return where between -0.5 and 0.5 a parabola through three values has its top."""
    bend = max(2 * here - before - after, 1e-6)
    return min(max((after - before) / (2 * bend), -0.5), 0.5)


@compiled
def _alone(image, kernel, u, v, peak_dn, level, ring):
    """Return whether it is dark around a peak in half of the directions."""
    around = np.empty(len(ring))
    for k in range(len(ring)):
        around[k] = filtered_at(image, kernel.weights,
                                min(max(u + ring[k, 0], 0), image.shape[1] - 1),
                                min(max(v + ring[k, 1], 0), image.shape[0] - 1))
    return np.median(around) - level < RING_LIGHT * peak_dn


@compiled
def row_tops(image):
    """Return the brightest pixel of each row (H,) of image (H, W), and the darkest of all."""
    tops, darkest = np.empty(len(image), image.dtype), image[0, 0]
    for v in range(len(image)):
        line, top, least = image[v], image[v, 0], image[v, 0]
        for u in range(len(line)):
            top, least = max(top, line[u]), min(least, line[u])
        tops[v], darkest = top, min(darkest, least)
    return tops, darkest


def full_scale(image: np.ndarray, tops: np.ndarray, background_dn: float) -> float:
    """Return the DN at which the image saturates, infinity when nothing in it is saturated.

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
def _flat_top(image, tops):
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
