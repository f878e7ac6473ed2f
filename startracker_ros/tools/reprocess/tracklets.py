# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command tracklets: moving objects of a run as rows, as TDM, and located by two observers."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
import time

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.astro.state import State
from startracker_ros.core.locate.line_of_sight import LineOfSight, without_aberration
from startracker_ros.core.locate.locator import Located, TargetLocator
from startracker_ros.core.locate.observer import ObservedLine
from startracker_ros.core.maths.rotation import (
    angle_between, ARCSEC, east_and_north, unit_from_radec)
from startracker_ros.io.export.tdm import tdm_text, TrackletAngles
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.table import Result
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE
from startracker_ros.tools.reprocess.runs import open_run, Run
from startracker_ros.tools.reprocess.tracklet_joining import split_tracklets, tracklet_rows

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

    BagError where the folder is no run; OSError where a file cannot be written.
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
