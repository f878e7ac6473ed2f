# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Catalogue triangles that an image triangle may be, with the support of further image stars.

Image triangle abc has the angles theta_k and noise gates rho_k of its sides k = ab, ac, bc
(pair_search.py). Catalogue stars A, B, C have the separations d_k. The scale that fits best is

    s = sum_k theta_k d_k / rho_k^2 / sum_k theta_k^2 / rho_k^2

and the triangle fits when s is in the band that is searched and

    |d_k - s theta_k| <= rho_k,    A . (B x C) a . (b x c) > 0.

The second condition is the handedness. It is left out where noise may turn the triangle
over. Sides ab and ac come out of the k-vector and are joined through A; side bc is computed.
By chance

    4 n_ab n_ac / N  theta_bc rho_bc / (2 pi F)

triangles fit where e = 0 and all angles are small: the size of the join, times the probability
that the third side of a triangle of area F agrees if the angle at A is random.

The fourth star of the pyramid of Mortari et al. (2004) is up to 20 stars here: support.py predicts
where A, B, C put the other image stars.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.catalog.sky_grid import SkyGrid
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.identify.clock import SearchClock, time_is_up
from startracker_ros.core.identify.pair_search import (
    band_count, entry_range, image_side, list_entries, PairLevel, scale_band, ScaleBand, Side)
from startracker_ros.core.identify.support import (
    DECISIVE, support, Supporters, supporters, triple_product)
from startracker_ros.core.identify.verification import MAX_VERIFIED, VerifierData

# A triangle flatter than this many sigmas of its own height has no sure handedness.
_FLAT_SIGMAS = 4.0
# Steps of a search are members of its lists and joins, of this expected time in ns. To look up
# the support of a triangle takes as long as so many. The clock is read after so many at least.
_STEP_NS, _SUPPORT_STEPS, _CLOCK_STEPS = 4.0, 250, 20_000


class ImageTriangle(NamedTuple):
    """Sides of a triangle, sum of theta^2 / rho^2, a . (b x c), and whether it is flat."""

    ab: Side
    ac: Side
    bc: Side
    norm: float
    volume: float
    flat: bool


@compiled
def image_triangle(image: np.ndarray, sigma: np.ndarray, base: np.ndarray,
                   tolerance_sigmas: float) -> ImageTriangle:
    """Return the triangle of image stars base (3,), of unit vectors (N, 3), errors (N,) in rad."""
    a, b, c = base[0], base[1], base[2]
    ab = image_side(image, sigma, tolerance_sigmas, a, b)
    ac = image_side(image, sigma, tolerance_sigmas, a, c)
    bc = image_side(image, sigma, tolerance_sigmas, b, c)
    norm = ab.weight * ab.theta + ac.weight * ac.theta + bc.weight * bc.theta
    volume = triple_product(image, a, b, c)
    flat = (abs(volume) < max(ab.rho, ac.rho, bc.rho) / tolerance_sigmas * _FLAT_SIGMAS
            * max(ab.theta, ac.theta, bc.theta))
    return ImageTriangle(ab, ac, bc, norm, volume, flat)


@inlined
def _sides_fit(triangle: ImageTriangle, band: ScaleBand, d_ab: float, d_ac: float, d_bc: float
               ) -> bool:
    """Return whether three separations fit with one common scale."""
    ab, ac, bc = triangle.ab, triangle.ac, triangle.bc
    s = (d_ab * ab.weight + d_ac * ac.weight + d_bc * bc.weight) / triangle.norm
    return (band.low <= s < band.high
            and abs(d_ab - s * ab.theta) <= ab.rho
            and abs(d_ac - s * ac.theta) <= ac.rho
            and abs(d_bc - s * bc.theta) <= bc.rho)


@compiled
def catalogue_triangles(level: PairLevel, verifier: VerifierData, image: np.ndarray,
                        sigma: np.ndarray, base: np.ndarray, tested: np.ndarray,
                        clock: SearchClock) -> tuple[np.ndarray, int]:
    """
    Return the best supported catalogue triangles (MAX_VERIFIED, 3) of an image triangle.

    And how many they are. image (N, 3), sigma (N,) and base (3,) as in image_triangle(); tested
    (1,) counts the triangles that fit. When time is up these are the best so far.
    """
    triangle = image_triangle(image, sigma, base, verifier.tolerance_sigmas)
    stars = supporters(verifier.sky, image, sigma, base, verifier.tolerance_sigmas)
    best = np.empty((MAX_VERIFIED, 3), np.int64)
    supports = np.zeros(MAX_VERIFIED)
    bands = band_count(verifier.scale_error)
    for band in range(bands):
        if _search_band(level, verifier.sky, triangle,
                        scale_band(band, bands, verifier.scale_error), stars, best, supports,
                        tested, clock):
            break
    # Candidates with a third of the support of the best one or less are chance.
    count = 0
    while count < MAX_VERIFIED and supports[count] > supports[0] / 3:
        count += 1
    return best, count


@compiled
def _search_band(level: PairLevel, sky: SkyGrid, triangle: ImageTriangle, band: ScaleBand,
                 stars: Supporters, best: np.ndarray, supports: np.ndarray, tested: np.ndarray,
                 clock: SearchClock) -> bool:
    """
    Join sides ab and ac in one band, put the fitting triangles into best (M, 3), supports (M,).

    Return whether that ends the search: time is up, or a triangle is DECISIVE.
    """
    # Taken out of the tuples once: each access costs more than what is done with the value.
    separation, member, star = level.table.values, level.member, level.star
    direction, latest, previous = level.direction, level.latest, level.previous
    low, high = entry_range(level.table, triangle.ab, band)
    list_entries(level, low, high)
    begin, end = entry_range(level.table, triangle.ac, band)
    low2, high2 = _squared_chords(triangle.bc, band)
    steps = high - low
    for ac in range(begin, end):
        steps += 1
        if steps > _CLOCK_STEPS:
            if time_is_up(clock, _STEP_NS * steps):
                return True
            steps = 0
        a, c = member[ac], member[ac ^ 1]
        ab = latest[a]
        if not low <= ab < high:
            continue
        x, y, z = direction[c, 0], direction[c, 1], direction[c, 2]
        while ab >= low:
            steps += 1
            b = member[ab ^ 1]
            dx, dy, dz = direction[b, 0] - x, direction[b, 1] - y, direction[b, 2] - z
            chord2 = dx * dx + dy * dy + dz * dz
            if (low2 <= chord2 <= high2
                    and _sides_fit(triangle, band, separation[ab >> 1], separation[ac >> 1],
                                   2 * np.arcsin(np.sqrt(chord2) / 2))
                    and (triangle.flat or triple_product(
                        direction, int(a), int(b), int(c)) * triangle.volume > 0)):
                tested[0] += 1
                steps += _SUPPORT_STEPS
                found = support(sky, stars, int(star[a]), int(star[b]), int(star[c]),
                                max(supports[-1], supports[0] / 3))
                _keep(best, supports, star[a], star[b], star[c], found)
                if found >= DECISIVE:
                    return True
            ab = previous[ab]
    return time_is_up(clock, _STEP_NS * steps)


@inlined
def _squared_chords(side: Side, band: ScaleBand) -> tuple[float, float]:
    """Return the squared chords between which the catalogue pairs of a side are."""
    theta, rho = side.theta, side.rho
    low = 2 * np.sin(max(band.centre * theta - rho - band.half * theta, 0.0) / 2)
    high = 2 * np.sin(min(band.centre * theta + rho + band.half * theta, np.pi) / 2)
    return low * low, high * high


@inlined
def _keep(best: np.ndarray, supports: np.ndarray, a: int, b: int, c: int, found: float) -> None:
    """Insert a triangle of so much support into the best (M, 3), the most (M,) first."""
    if found <= supports[-1]:
        return
    row = len(supports) - 1
    while row > 0 and supports[row - 1] < found:
        supports[row] = supports[row - 1]
        for k in range(3):
            best[row, k] = best[row - 1, k]
        row -= 1
    supports[row] = found
    best[row, 0], best[row, 1], best[row, 2] = a, b, c
