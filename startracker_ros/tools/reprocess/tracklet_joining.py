# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One tracklet for each moving object: over borders of segments, gaps and ends of bags."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import ARCSEC, east_and_north, unit_from_radec
from startracker_ros.core.maths.sorting import lowest_connected
from startracker_ros.core.track.tracklets import tangent
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE

_ARC_RAD = np.radians(3.0)
"""Of the detections next to a gap from which the motion at its side is found, but five at least:
on a longer one a parabola does not follow what passes."""

_MOST_PATH_RAD = np.radians(6.0)
"""In a gap: on a longer path almost any two motions may be one."""

_DETECTIONS_A_DEGREE = 5
_ORBIT_RAD_S2 = 1.2e-6
"""Standard deviation of the acceleration by the gravity of the Earth: the square of the rate in a
low orbit."""

_GATE = gate(1e-4, 4)


class _Motion(NamedTuple):
    """A direction (3,), its rate (3,) in rad/s, covariance (2, 2) of both per axis."""

    time_s: float
    direction: np.ndarray
    rate: np.ndarray
    covariance: np.ndarray


def tracklet_rows(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the table tracklets of a run as rows with one number for each object."""
    rows = np.zeros(len(table['stamp_ns']), TRACKLET_DTYPE)
    for name in rows.dtype.names or ():
        rows[name] = table[name]
    return continued(joined(rows))


def joined(rows: np.ndarray) -> np.ndarray:
    """
    Return rows (N,) of all segments with one number for each object, and each detection once.

    An object that crosses the border of two segments has a tracklet in each, which share the
    detections of the overlap; the number becomes that of the first one. Of a detection the row of
    the earlier segment stays, as of the frame.
    """
    rows = rows[np.lexsort((rows['tracklet'], rows['v'], rows['u'], rows['stamp_ns']))]
    if not len(rows):
        return rows
    same = np.ones(len(rows) - 1, bool)
    for name in ('stamp_ns', 'u', 'v'):
        same &= rows[name][1:] == rows[name][:-1]
    pairs = np.stack([rows['tracklet'][:-1][same], rows['tracklet'][1:][same]], -1)
    return _renumbered(rows, pairs)[np.append(True, ~same)]


def continued(rows: np.ndarray) -> np.ndarray:
    """
    Return rows (N,) as of joined() with one number for an object that was lost for a while.

    A tracklet goes on as another one if the gap is no longer than the shorter of both and if
    direction and rate at its two sides agree within 1e-4 of chance. What passes at a constant
    velocity moves on a great circle, where it accelerates by 2 w^2 tan(theta) with its angular
    rate w, theta from the closest approach: 2 w^2 is the standard deviation along the motion.
    Where two come into question neither is taken.
    """
    parts = split_tracklets(rows)
    duration_s = [float(part['stamp_ns'][-1] - part['stamp_ns'][0]) * 1e-9 for part in parts]
    ends, begins = ([_motion(part, side) for part in parts] for side in (-1, 0))
    begin_s = np.array([begin.time_s for begin in begins])
    order = np.argsort(begin_s, kind='stable')
    pairs = []
    for before, end in enumerate(ends):
        for place in range(*np.searchsorted(
                begin_s[order], [end.time_s, end.time_s + duration_s[before]], side='right')):
            after = int(order[place])
            gap_s = begins[after].time_s - end.time_s
            if gap_s <= min(duration_s[before], duration_s[after]) and _agree(
                    end, begins[after], gap_s):
                pairs.append((before, after))
    found = np.array(pairs, int).reshape(-1, 2)
    alone = [np.bincount(side, minlength=len(parts))[side] == 1 for side in found.T]
    numbers = np.array([part['tracklet'][0] for part in parts], np.int64)
    return _renumbered(rows, numbers[found[alone[0] & alone[1]]])


def split_tracklets(rows: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each tracklet, in the order of its number and of time."""
    if not len(rows):
        return []
    rows = rows[np.lexsort((rows['stamp_ns'], rows['tracklet']))]
    return np.split(rows, 1 + np.flatnonzero(np.diff(rows['tracklet'])))


def _renumbered(rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return rows in which both numbers of each pair (M, 2), and of chains, are the least one."""
    numbers, place = np.unique(rows['tracklet'], return_inverse=True)
    rows = rows.copy()
    first = lowest_connected(np.searchsorted(numbers, pairs), len(numbers))
    rows['tracklet'] = numbers[first][place]
    return rows


def _motion(rows: np.ndarray, side: int) -> _Motion:
    """Return the motion at the first (0) or last (-1) of detections, by a polynomial in time."""
    direction = unit_from_radec(np.radians(rows['ra_deg']), np.radians(rows['dec_deg']))
    apart = np.linalg.norm(direction - direction[side], axis=1)
    used = apart <= max(_ARC_RAD, np.sort(apart)[_DETECTIONS_A_DEGREE - 1])
    x = tangent(direction[side], direction[used])
    time_s = (rows['stamp_ns'][used] - rows['stamp_ns'][side]) * 1e-9
    variance_arcsec2 = (rows['cov_ee_arcsec2'] + rows['cov_nn_arcsec2'])[used].astype(float) / 2
    sigma = np.sqrt(variance_arcsec2) * ARCSEC
    degree = min(2, len(x) // _DETECTIONS_A_DEGREE)
    scale_s = np.ptp(time_s)
    design = np.vander(time_s / scale_s, degree + 1, increasing=True) / sigma[:, None]
    covariance = np.linalg.inv(design.T @ design)
    fit = covariance @ design.T @ (x / sigma[:, None])
    axes, per_s = east_and_north(direction[side]), np.array([1.0, 1 / scale_s])
    fitted = direction[side] + fit[0] @ axes
    return _Motion(float(rows['stamp_ns'][side] * 1e-9), fitted / np.linalg.norm(fitted),
                   fit[1] / scale_s @ axes, covariance[:2, :2] * np.outer(per_s, per_s))


def _agree(end: _Motion, begin: _Motion, gap_s: float) -> bool:
    """Return whether a motion goes on as another one after a gap."""
    axes = east_and_north(end.direction)
    before, after = axes @ end.rate, axes @ begin.rate
    if gap_s * max(np.linalg.norm(before), np.linalg.norm(after)) > _MOST_PATH_RAD:
        return False
    innovation = np.stack([tangent(end.direction, begin.direction) - before * gap_s,
                           after - before])
    along = (before + after) / max(np.linalg.norm(before + after), 1e-12)
    across = np.array([-along[1], along[0]])
    passing = before @ before + after @ after
    F = np.array([[1.0, gap_s], [0.0, 1.0]])
    measured = F @ end.covariance @ F.T + begin.covariance
    Q = gap_s * np.array([[gap_s ** 3 / 3, gap_s ** 2 / 2], [gap_s ** 2 / 2, gap_s]])
    square = 0.0
    for axis, acceleration in ((along, np.hypot(passing, _ORBIT_RAD_S2)),
                               (across, _ORBIT_RAD_S2)):
        x = innovation @ axis
        square += x @ np.linalg.solve(measured + acceleration ** 2 * Q, x)
    return bool(square <= _GATE)
