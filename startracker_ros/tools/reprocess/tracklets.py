# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command tracklets: moving objects of a run as rows, as TDM, and located by two observers."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
import time
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.astro.state import State
from startracker_ros.core.locate.line_of_sight import LineOfSight, without_aberration
from startracker_ros.core.locate.locator import Located, TargetLocator
from startracker_ros.core.locate.observer import ObservedLine
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import (
    angle_between, ARCSEC, east_and_north, unit_from_radec)
from startracker_ros.core.maths.sorting import lowest_connected
from startracker_ros.core.track.tracklets import tangent
from startracker_ros.io.export.tdm import tdm_text, TrackletAngles
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.table import Result
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE
from startracker_ros.tools.reprocess.tables import open_run, Run

# --- one tracklet for each object: over borders of segments, gaps and ends of bags ---

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


# --- the command ---

_POSITION_SIGMA_M = 10.0
_LOCATED_SHARE = 0.5


@dataclass(frozen=True)
class TrackletRow:
    """
    A moving object: where it is seen first, how it moves against the stars, and its magnitude.

    located_with is the tracklet of another tracker that its lines of sight meet, range_m the
    median distance from this one.
    """

    tracker: str
    tracklet: int
    utc: str
    duration_s: float
    detections: int
    ra_deg: float
    dec_deg: float
    sigma_arcsec: float
    rate_deg_s: float
    magnitude: float
    located_with: str
    range_m: float | None


@dataclass(frozen=True)
class _Tracklet:
    """The rows of a tracklet, in the order of time."""

    tracker: str
    number: int
    rows: np.ndarray

    @property
    def name(self) -> str:
        return f'{self.tracker}_{self.number}'

    @property
    def direction(self) -> np.ndarray:
        """Apparent unit vectors (N, 3)."""
        return unit_from_radec(np.radians(self.rows['ra_deg']), np.radians(self.rows['dec_deg']))

    @property
    def covariance_arcsec2(self) -> np.ndarray:
        """Covariances (N, 2, 2) on axes to the east and north."""
        columns = [self.rows[f'cov_{pair}_arcsec2'] for pair in ('ee', 'en', 'en', 'nn')]
        return np.stack(columns, -1).reshape(-1, 2, 2)


def tracklets(folder: Path, output: Path, originator: str) -> Result:
    """
    Return a row for each moving object of a run, and write a TDM for each tracker into output.

    BagError where the folder is not a run; OSError where a file cannot be written.
    """
    run = open_run(folder)
    found = {tracker: _read(run, tracker) for tracker in run.trackers}
    located = _located(found)
    output_folder(output)
    files = []
    for tracker, of_tracker in found.items():
        if of_tracker:
            files.append(output / f'{tracker}.tdm')
            write_output(files[-1], tdm_text(tracker, originator, [
                TrackletAngles(one.name, one.rows['stamp_ns'], one.rows['ra_deg'],
                               one.rows['dec_deg'], one.covariance_arcsec2, one.rows['magnitude'])
                for one in of_tracker], time.time_ns()))
    rows = [_row(one, *located.get(one.name, ('', None)))
            for of_tracker in found.values() for one in of_tracker]
    return Result('tracklets', rows, {
        'files': ', '.join(str(path) for path in files) or 'none'})


def _read(run: Run, tracker: str) -> list[_Tracklet]:
    table = run.table('tracklets', tracker, list(TRACKLET_DTYPE.names or ()))
    return [_Tracklet(tracker, int(part['tracklet'][0]), part)
            for part in split_tracklets(tracklet_rows(table))]


def _row(one: _Tracklet, located_with: str, range_m: float | None) -> TrackletRow:
    rows, direction = one.rows, one.direction
    duration_s = float(rows['stamp_ns'][-1] - rows['stamp_ns'][0]) * 1e-9
    angle_deg = np.degrees(angle_between(direction[-1], direction[0]))
    variance = (rows['cov_ee_arcsec2'] + rows['cov_nn_arcsec2']) / 2
    return TrackletRow(
        one.tracker, one.number, utc(int(rows['stamp_ns'][0])), duration_s, len(rows),
        float(rows['ra_deg'][0]), float(rows['dec_deg'][0]), float(np.sqrt(variance.mean())),
        float(angle_deg / duration_s), float(np.median(rows['magnitude'])), located_with, range_m)


def _located(found: dict[str, list[_Tracklet]]) -> dict[str, tuple[str, float]]:
    """Return the partner of tracklets by name and the median range, where lines of sight meet."""
    located: dict[str, tuple[str, float]] = {}
    for first, second in combinations(found, 2):
        for one in found[first]:
            for two in found[second]:
                ranges = _ranges_m(one, two)
                if len(ranges):
                    own, other = np.median(ranges, axis=0)
                    located[one.name] = two.name, float(own)
                    located[two.name] = one.name, float(other)
    return located


def _ranges_m(one: _Tracklet, two: _Tracklet) -> np.ndarray:
    """Return the ranges (N, 2) of two tracklets at their common times, (0, 2) if they miss."""
    stamps = [tracklet.rows['stamp_ns'] for tracklet in (one, two)]
    begin, end = (int(select(part[index] for part in stamps))
                  for select, index in ((max, 0), (min, -1)))
    locator = TargetLocator((one.name, two.name))
    located: list[Located] = []
    common = 0
    # In the order of time, so that histories stay short.
    events = sorted((int(stamp), which, index) for which in range(2)
                    for index, stamp in enumerate(stamps[which]) if begin <= stamp <= end)
    for stamp_ns, which, index in events:
        tracklet = (one, two)[which]
        line, state = _line(tracklet, index)
        if line is None:
            return np.empty((0, 2))
        observer = locator.observers[which]
        observer.add_state(stamp_ns, state)
        observer.lines.add(stamp_ns, line)
        common += which == 0
        located += [result for result in locator.solve() if isinstance(result, Located)]
    if not common or len(located) < _LOCATED_SHARE * common:
        return np.empty((0, 2))
    return np.array([result.location.range_m for result in located])


def _line(tracklet: _Tracklet, index: int) -> tuple[ObservedLine | None, State]:
    """Return the line of sight of a detection without aberration, None without a position."""
    row = tracklet.rows[index]
    position_m = np.array([row[f'position_{axis}_m'] for axis in 'xyz'])
    velocity_m_s = np.array([row[f'velocity_{axis}_m_s'] for axis in 'xyz'])
    state = State(position_m, velocity_m_s, _POSITION_SIGMA_M ** 2 * np.eye(3))
    if not np.isfinite([position_m, velocity_m_s]).all():
        return None, state
    direction = tracklet.direction[index]
    axes = east_and_north(direction)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = state.covariance_m2
    covariance[3:, 3:] = axes.T @ (
        tracklet.covariance_arcsec2[index] * ARCSEC ** 2) @ axes
    return ObservedLine(LineOfSight(
        position_m, without_aberration(direction, velocity_m_s), covariance), velocity_m_s), state
