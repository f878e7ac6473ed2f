# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Catalogue pairs that may be one side of an image triangle: k-vector range and star lists.

Image stars i and j are an angle theta apart, measured with the errors sigma_i and sigma_j. The
noise gate is

    rho = n sqrt(sigma_i^2 + sigma_j^2),    n = tolerance_sigmas.

The focal length is known to a share e, so that the true separation is s theta with
1 - e <= s <= 1 + e. That range is cut into B bands of centre s_0 and half width h. In a band
the catalogue pairs of separation d with

    |d - s_0 theta| <= rho + h theta

may be the side. They are one range of the pairs sorted by d, found by the k-vector (Mortari
and Neta 2000). Of N stars spread evenly over the sky

    n_ij = N^2 / 2 sin theta (rho + e theta)

pairs are in the ranges of all bands by chance. Sides ab and ac are joined in their common star:
the pairs of ab are listed by star, like the identifier array of Yuan, Zhang, Shi (2017), and each
pair of ac finds those of its two stars. By chance the join has 4 n_ab n_ac / (N B) members.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.identify.kvector import first_beyond, first_from, KVectorTable
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.identify.support import squared_chord

# Width of a band of focal lengths to either side, as a share.
_BAND = 0.005


class PairLevel(NamedTuple):
    """
    The pairs of the S brightest catalogue stars, and the work arrays of a join.

    star (S,) are catalogue indices, direction (S, 3) unit vectors. Pair p has the separation
    table.values[p] in rad and the stars member[2 p], member[2 p + 1], so that entry e stands for
    a star member[e] with the partner member[e ^ 1]. previous[e] is the entry before e of the
    same star, -1 for none. latest (S,) is that of list_entries(). A search uses image_stars
    stars of the image and at most so many triangles.
    """

    table: KVectorTable
    star: np.ndarray
    direction: np.ndarray
    member: np.ndarray
    previous: np.ndarray
    latest: np.ndarray
    image_stars: int
    triangles: int


class Side(NamedTuple):
    """Angle theta and noise gate rho in rad of an image side, and theta / rho^2."""

    theta: float
    rho: float
    weight: float


class ScaleBand(NamedTuple):
    """Centre and half width of a band of focal lengths; low <= s < high belong to it."""

    centre: float
    half: float
    low: float
    high: float


def pair_level(pairs: PairDatabase, image_stars: int, triangles: int) -> PairLevel:
    """Return the level of these pairs."""
    return PairLevel(pairs.kvector.table, pairs.star, pairs.direction, pairs.member,
                     pairs.previous, np.full(len(pairs.star), -1, pairs.member.dtype),
                     image_stars, triangles)


@compiled
def image_side(image: np.ndarray, sigma: np.ndarray, tolerance_sigmas: float, i: int, j: int
               ) -> Side:
    """Return the side between image stars i and j, of unit vectors (N, 3) and errors (N,) rad."""
    theta = 2 * np.arcsin(min(np.sqrt(squared_chord(image, i, j)) / 2, 1.0))
    rho = tolerance_sigmas * np.sqrt(sigma[i] ** 2 + sigma[j] ** 2)
    return Side(theta, rho, theta / rho ** 2)


@inlined
def band_count(scale_error: float) -> int:
    """Return B, the number of bands."""
    return max(int(np.ceil(scale_error / _BAND)), 1)


@compiled
def scale_band(band: int, count: int, scale_error: float) -> ScaleBand:
    """Return one of count bands; the outer ones are open, since the noise gates bound them."""
    half = scale_error / count
    centre = 1 - scale_error + (2 * band + 1) * half
    return ScaleBand(centre, half, centre - half if band > 0 else 0.0,
                     centre + half if band < count - 1 else np.inf)


@compiled
def expected_pairs(separation: np.ndarray, stars: int, side: Side, scale_error: float) -> float:
    """Return n_ij, 0 where the separations (P,) of the database do not reach."""
    reach = side.rho + scale_error * side.theta
    if (not len(separation) or side.theta + reach < separation[0]
            or side.theta - reach > separation[-1]):
        return 0.0
    return stars ** 2 / 4 * np.sin(side.theta) * 2 * reach


@compiled
def entry_range(table: KVectorTable, side: Side, band: ScaleBand) -> tuple[int, int]:
    """Return the first entry of the pairs that may be a side, and the first beyond."""
    theta, rho = side.theta, side.rho
    return (2 * first_from(table, band.centre * theta - rho - band.half * theta),
            2 * first_beyond(table, band.centre * theta + rho + band.half * theta))


@compiled
def list_entries(level: PairLevel, low: int, high: int) -> None:
    """
    Put the last entry e, low <= e < high, of each star into latest (S,).

    Values outside that range are left over from other ranges: their stars have no entry in it.
    The others are reached by previous, as long as they are not below low.
    """
    member, latest = level.member, level.latest
    for entry in range(low, high):
        latest[member[entry]] = entry
