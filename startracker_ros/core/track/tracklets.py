# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Moving objects among centroids that are not stars, linked over many frames at once.

Two detections in neighbouring frames are a pair, two pairs that share a detection and go on at the
same rate a triple. The longest chains of triples are fitted with a polynomial in time and
verified. A false detection seldom has a partner at the place that a pair predicts: chains of five
are objects, or spots that do not move in the image (hot pixels) or on the sky (stars).
"""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri
from startracker_ros.core.maths.rotation import east_and_north
from startracker_ros.core.track.target import GATE, MOVES_SIGMA, TargetTrackOptions

_LAGS = (1, 2, 3, 4)
"""Frames from one detection to the next: three may be missed."""

_FALSE_ALARM = 1e-6
_OUTLIER_SIGMA = 4.0
_MOST_DEGREE = 3
_FRAMES_A_DEGREE = 5


class Detections(NamedTuple):
    """
    Centroids that are not stars, in the order of time.

    frame (N,) numbers the frames, time_s (N,), direction (N, 3) on ICRF axes with variance (N,) in
    rad^2 per axis, uv (N, 2) px with sigma_px (N,).
    """

    frame: np.ndarray
    time_s: np.ndarray
    direction: np.ndarray
    variance: np.ndarray
    uv: np.ndarray
    sigma_px: np.ndarray


def link_tracklets(found: Detections, options: TargetTrackOptions = TargetTrackOptions()
                   ) -> list[np.ndarray]:
    """Return the detections (K,) of each moving object, ascending; each belongs to one at most."""
    if len(found.frame) < options.target_confirm_frames:
        return []
    first, second = _pairs(found, np.radians(options.target_max_rate_deg_s))
    before, after = _triples(found, first, second,
                             np.radians(options.target_acceleration_deg_s2))
    length, previous = np.full(len(first), 2), np.full(len(first), -1)
    # Pairs are in the order of their first detection, so triples in that of their middle.
    for p, q in zip(before.tolist(), after.tolist()):
        if length[p] + 1 > length[q]:
            length[q], previous[q] = length[p] + 1, p
    used, tracklets = np.zeros(len(found.frame), bool), []
    for pair in np.argsort(-length, kind='stable'):
        if length[pair] < options.target_confirm_frames:
            break
        chain, pair = [int(second[pair])], int(pair)
        while pair >= 0:
            chain.append(int(first[pair]))
            pair = int(previous[pair])
        member = np.array(chain[::-1])
        if used[member].any():
            continue
        member = _verified(found, member, options)
        if len(member):
            used[member] = True
            tracklets.append(member)
    return sorted(tracklets, key=lambda member: int(member[0]))


def _pairs(found: Detections, max_rate_rad_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs (P,), (P,) of neighbouring frames, within the rate, ordered by the first."""
    first, second = [], []
    for lag in _LAGS:
        begin = np.searchsorted(found.frame, found.frame + lag)
        end = np.searchsorted(found.frame, found.frame + lag, side='right')
        i, j = _expanded(begin, end)
        first.append(i)
        second.append(j)
    i, j = np.concatenate(first), np.concatenate(second)
    separation = np.linalg.norm(found.direction[j] - found.direction[i], axis=1)
    reach = max_rate_rad_s * (found.time_s[j] - found.time_s[i]) + MOVES_SIGMA * np.sqrt(
        found.variance[i] + found.variance[j])
    near = separation <= reach
    i, j = i[near], j[near]
    order = np.lexsort((j, i))
    return i[order], j[order]


def _triples(found: Detections, first: np.ndarray, second: np.ndarray,
             acceleration_rad_s2: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return pairs p = (i, j) and q = (j, l) that go on at the same rate, ordered by j.

    In the tangent plane at j: x_l = -a x_i with a = (t_l - t_j) / (t_j - t_i).
    """
    p, q = _expanded(np.searchsorted(first, second), np.searchsorted(first, second, side='right'))
    i, j, k = first[p], second[p], second[q]
    x_i, x_k = (tangent(found.direction[j], found.direction[other]) for other in (i, k))
    before_s, after_s = found.time_s[j] - found.time_s[i], found.time_s[k] - found.time_s[j]
    a = after_s / before_s
    curved = acceleration_rad_s2 / 2 * after_s * (before_s + after_s)
    variance = (found.variance[k] + a ** 2 * found.variance[i]
                + (1 + a) ** 2 * found.variance[j] + curved ** 2)
    good = np.sum((x_k + a[:, None] * x_i) ** 2, axis=1) <= GATE * variance
    p, q = p[good], q[good]
    order = np.lexsort((p, first[q]))
    return p[order], q[order]


def _expanded(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each index (M,) with each number from its begin to its end."""
    count = end - begin
    index = np.repeat(np.arange(len(begin)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return index, begin[index] + offset


def tangent(centre: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return coordinates (N, 2) of directions (N, 3) to the east and north of centres (N, 3)."""
    ahead = np.sum(direction * centre, axis=-1)
    return (east_and_north(centre) @ direction[..., None])[..., 0] / ahead[..., None]


def _verified(found: Detections, member: np.ndarray, options: TargetTrackOptions) -> np.ndarray:
    """Return a chain without its outliers, empty unless it is a moving object."""
    centre = found.direction[member].mean(axis=0)
    x = tangent(centre / np.linalg.norm(centre), found.direction[member])
    for _ in range(3):
        if len(member) < options.target_confirm_frames:
            return member[:0]
        t, sigma = found.time_s[member], np.sqrt(found.variance[member])
        s = (t - t.mean()) / max(np.ptp(t), 1e-9)
        degree = min(_MOST_DEGREE, len(member) // _FRAMES_A_DEGREE)
        design = np.vander(s, degree + 1) / sigma[:, None]
        fit = np.linalg.lstsq(design, x / sigma[:, None], rcond=None)[0]
        normalised = np.linalg.norm(x / sigma[:, None] - design @ fit, axis=1)
        inlier = normalised <= _OUTLIER_SIGMA
        if inlier.all():
            break
        member, x = member[inlier], x[inlier]
    else:
        return member[:0]
    dof = 2 * (len(member) - degree - 1)
    moved = np.linalg.norm(x[-1] - x[0])
    spread_px = np.linalg.norm(np.ptp(found.uv[member], axis=0))
    sigma_px = float(np.median(found.sigma_px[member]))
    is_object = (
        normalised @ normalised <= chdtri(dof, _FALSE_ALARM)
        and moved >= max(np.radians(options.target_min_rate_deg_s) * np.ptp(t),
                         MOVES_SIGMA * np.hypot(sigma[0], sigma[-1]))
        # The extent of a spot that stays on its pixels is that of its noise.
        and spread_px >= max(options.target_min_shift_px, 2 * MOVES_SIGMA * sigma_px))
    return member if is_object else member[:0]
