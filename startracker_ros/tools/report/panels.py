# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of the report as plain data: what is drawn over time, histograms, key figures."""

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr
from startracker_ros.core.maths.rotation import ARCSEC, pointing_from_quaternion
from startracker_ros.io.recordings.recording import Clouds, gaps_after, Recording

# A curve of more samples is thinned to about this many, its extremes kept.
SAMPLES = 4000
WITHOUT_ATTITUDE = 'TRACKING, no attitude'
AXES = ('x, cross boresight', 'y, cross boresight', 'z, roll')
STAGES = {
    'centroids': ('image_raw', 'centroids'), 'tracking': ('centroids', 'tracks'),
    'attitude': ('tracks', 'attitude'), 'image to attitude': ('image_raw', 'attitude')}
"""Stages of the pipeline: from sending the first topic to sending the last, of one frame."""

Panel = dict[str, Any]
# With fewer frames than this the figure is marked.
_MOST_FRAMES_PERCENT = 90.0
# Times that leave the figure, over those that 95 % of the frames take.
_SPIKE = 2.5


class KeyFigure(NamedTuple):
    """A figure as text with its unit, and as a number; low is whether it deserves attention."""

    text: str
    value: float
    unit: str
    p95: float | None = None
    low: bool = False


def numbers(values: np.ndarray, digits: int) -> list[float | int | None]:
    """Return JSON numbers with digits after the point; None for what is not finite."""
    return [round(value, digits) if math.isfinite(value) else None
            for value in np.asarray(values, float).tolist()]


def thinned(columns: Sequence[np.ndarray], samples: int = SAMPLES) -> np.ndarray:
    """Return sorted indices of columns (N,): all, or the extremes of each of many intervals."""
    count = len(columns[0])
    if count <= samples:
        return np.arange(count)
    chosen = {0, count - 1}
    bins = max(1, samples // (2 * len(columns)))
    for part in np.array_split(np.arange(count), bins):
        for column in columns:
            # NaN compares as neither: an interval of nothing else keeps its first.
            values = column[part]
            chosen.add(int(part[np.argmax(np.where(np.isnan(values), -np.inf, values))]))
            chosen.add(int(part[np.argmin(np.where(np.isnan(values), np.inf, values))]))
    return np.array(sorted(chosen))


class Panels:
    """The plain data of all figures of a recording; times are seconds since start_ns."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.frame_ns = recording.frame_ns()
        # Without any frame the times of receipt are all there is.
        known = [self.frame_ns, recording.truth_ns, recording.stars.stamp_ns]
        if not any(map(len, known)):
            known = [recording.state_ns,
                     np.array([record.stamp_ns for record in recording.diagnostics], np.int64)]
        known_ns = np.concatenate(known)
        self.start_ns = int(known_ns.min()) if len(known_ns) else 0
        self.end_ns = int(known_ns.max()) if len(known_ns) else 0

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    def times(self, stamp_ns: np.ndarray) -> list[float | int | None]:
        """Return the JSON numbers of stamps (N,)."""
        return numbers((stamp_ns - self.start_ns) / 1e9, 4)

    def series(self, name: str, kind: str, stamp_ns: np.ndarray, values: np.ndarray,
               digits: int) -> dict[str, Any]:
        """Return a curve of values (N,) at stamps (N,), of not too many samples."""
        keep = thinned([values])
        return {'name': name, 'kind': kind, 't': self.times(stamp_ns[keep]),
                'y': numbers(values[keep], digits)}

    def states(self) -> list[dict[str, Any]]:
        """
        Return the intervals from, to, state of the tracker.

        TRACKING without an attitude is an interval of its own, and so is a time without frames.
        """
        recording = self.recording
        stamp_ns, states = recording.state_frame_ns(), np.array(recording.state, object)
        if not len(states) or not recording.knows_attitudes or not len(self.frame_ns):
            return self.intervals(stamp_ns, recording.state)
        frame_ns, has_attitude = self._frames_and_gaps()
        # The first state of a frame; a later one, after an identification, is that of the next.
        known = np.searchsorted(stamp_ns, frame_ns)
        known -= stamp_ns[np.minimum(known, len(stamp_ns) - 1)] != frame_ns
        shown = np.where(known >= 0, states[known], '')
        shown[(shown == 'TRACKING') & ~has_attitude] = WITHOUT_ATTITUDE
        return self.intervals(frame_ns[known >= 0], shown[known >= 0].tolist())

    def _frames_and_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps (N,) of frames and of begins of gaps, and which have an attitude."""
        frame_ns = self.frame_ns
        has_attitude = np.isin(frame_ns, self.recording.attitude_ns)
        gaps = gaps_after(frame_ns)
        begin_ns = frame_ns[gaps] + (np.median(np.diff(frame_ns)).astype(np.int64)
                                     if len(gaps) else 0)
        return (np.insert(frame_ns, gaps + 1, begin_ns),
                np.insert(has_attitude, gaps + 1, False))

    def intervals(self, stamp_ns: np.ndarray, states: Sequence[str]) -> list[dict[str, Any]]:
        """Return the intervals from, to, state of states (N,) that begin at stamps (N,)."""
        changes = [index for index, state in enumerate(states)
                   if index == 0 or state != states[index - 1]]
        starts = np.clip(stamp_ns[changes], self.start_ns, self.end_ns)
        ends = np.append(starts[1:], self.end_ns)
        return [{'from': first, 'to': last, 'state': states[index]}
                for first, last, index in zip(self.times(starts), self.times(ends), changes)]

    def attitude(self) -> list[Panel]:
        """Return panels of right ascension, declination and roll, the truth behind them."""
        curves = []
        for name, kind, stamp_ns, quaternion in (
                ('truth', 'line', self.recording.truth_ns, self.recording.truth_quaternion),
                ('attitude', 'dots', self.recording.attitude_ns, self.recording.quaternion)):
            if len(stamp_ns):
                keep = thinned([*quaternion.T])
                angles = np.degrees([pointing_from_quaternion(q) for q in quaternion[keep]])
                curves.append((name, kind, stamp_ns[keep], angles))
        panels = []
        for column, name in enumerate(('right ascension', 'declination', 'roll')):
            circle = name != 'declination'
            series, start_deg = [], None
            for label, kind, stamp_ns, angles in curves:
                values = angles[:, column]
                if circle:
                    values = np.unwrap(values, period=360)
                    # Both curves on the same turn of the circle.
                    start_deg = values[0] if start_deg is None else start_deg
                    values = values - 360 * np.round((values[0] - start_deg) / 360)
                series.append({'name': label, 'kind': kind, 't': self.times(stamp_ns),
                               'y': numbers(values, 6)})
            panels.append({'id': f'attitude-{name.replace(" ", "-")}', 'title': name,
                           'unit': 'deg', 'series': series, 'circle': 360 if circle else None})
        return panels

    def errors(self) -> list[Panel]:
        """Return a panel for each sensor axis: error, where there is truth, and its bounds."""
        stamps, error, sigma = self.recording.errors()
        if not len(stamps):
            stamps, sigma = self.recording.attitude_ns, self.recording.sigma_arcsec()
            error = np.empty((0, 3))
        bound = self.recording.protection_arcsec(stamps)
        panels = []
        for axis, name in enumerate(AXES):
            series = []
            if np.isfinite(bound[:, axis]).any():
                series.append(self.series('protection level', 'band', stamps, bound[:, axis], 4))
            if np.isfinite(sigma[:, axis]).any():
                series.append(self.series('3 sigma', 'band', stamps, 3 * sigma[:, axis], 4))
            if len(error):
                series.append(self.series('error', 'dots', stamps, error[:, axis], 4))
            panels.append({'id': f'error-{"xyz"[axis]}', 'title': name, 'unit': 'arcsec',
                           'series': series,
                           'range': _error_range(error[:, axis], sigma[:, axis],
                                                 bound[:, axis])})
        return panels

    def histograms(self) -> list[dict[str, Any]]:
        """Return counts of the error about each sensor axis, and what its sigma lets expect."""
        _, error, sigma = self.recording.errors()
        found = []
        for axis, name in enumerate(AXES if len(error) else ()):
            values = error[:, axis]
            spread = max(float(np.percentile(np.abs(values), 99)), 1e-9) * 1.25
            edges = np.linspace(-spread, spread, 32)
            counts, _ = np.histogram(values, edges)
            known = sigma[:, axis][np.isfinite(sigma[:, axis]) & (sigma[:, axis] > 0)]
            known = known[thinned([known])] if len(known) else known
            expected = None
            if len(known):
                below = ndtr(edges[:, None] / known).mean(axis=1)
                expected = numbers(np.diff(below) * len(values), 2)
            found.append({
                'title': name, 'edges': numbers(edges, 5), 'counts': counts.tolist(),
                'expected': expected, 'outside': int(len(values) - counts.sum()),
                'mean': round(float(values.mean()), 4), 'rms': round(_rms(values), 4)})
        return found

    def stars(self) -> list[Panel]:
        """Return one panel of star counts, with as many curves as the bag has stages."""
        recording, series = self.recording, []
        for name, clouds, which in (
                ('centroids', recording.centroids, None),
                ('identified lost-in-space', recording.stars, recording.stars.rows['hip'] > 0),
                ('tracks', recording.tracks, None),
                ('seen and identified', recording.tracks, usable(recording.tracks))):
            if len(clouds):
                kind = 'dots' if clouds is recording.stars else 'line'
                series.append(self.series(name, kind, clouds.stamp_ns,
                                          clouds.count(which).astype(float), 0))
        return [{'id': 'stars', 'title': 'stars', 'unit': '', 'series': series, 'zero': True}]

    def residuals(self) -> list[Panel]:
        """Return one panel of residuals of the tracks, or of single frames without them."""
        clouds = self.recording.tracks if len(self.recording.tracks) else self.recording.stars
        series = []
        used = np.isfinite(clouds.rows['residual_px']) & (
            usable(clouds) if clouds is self.recording.tracks else clouds.rows['hip'] > 0)
        if used.any():
            residual, frame = clouds.rows['residual_px'][used].astype(float), clouds.frame[used]
            count = np.bincount(frame, minlength=len(clouds))
            with np.errstate(invalid='ignore', divide='ignore'):
                rms = np.sqrt(np.bincount(frame, residual ** 2, len(clouds)) / count)
            largest = np.full(len(clouds), -np.inf)
            np.maximum.at(largest, frame, residual)
            series = [self.series('largest', 'line', clouds.stamp_ns, largest, 4),
                      self.series('rms', 'line', clouds.stamp_ns, rms, 4)]
        return [{'id': 'residuals', 'title': 'residuals', 'unit': 'px', 'series': series,
                 'zero': True}]

    def latency(self) -> list[Panel]:
        """Return one panel of the time that each stage took."""
        series = [self.series(name, 'line', stamps, spent, 3) for name, stamps, spent in (
            (name, *self.recording.stage_ms(*ends)) for name, ends in STAGES.items())
            if len(stamps)]
        times = [spent for ends in STAGES.values()
                 if len(spent := self.recording.stage_ms(*ends)[1])]
        limit = _SPIKE * max((float(np.percentile(spent, 95)) for spent in times), default=0.0)
        # One spike would flatten all else.
        spiky = any(spent.max() > limit for spent in times)
        return [{'id': 'latency', 'title': 'latency', 'unit': 'ms', 'series': series,
                 'zero': True, 'range': [0.0, round(limit, 3)] if spiky else None}]

    def latency_rows(self) -> list[tuple[str, int, float, float, float]]:
        """Return stage, frames, median, 95 % and longest ms of each stage in the bag."""
        rows = []
        for name, ends in STAGES.items():
            _, spent = self.recording.stage_ms(*ends)
            if len(spent):
                rows.append((name, len(spent), *np.percentile(spent, [50, 95, 100])))
        return rows

    def key_figures(self) -> dict[str, KeyFigure]:
        """Return what a reader wants to know first."""
        recording = self.recording
        frames, attitudes = len(self.frame_ns), len(recording.attitude_ns)
        figures = {'duration': KeyFigure(f'{self.duration_s:.1f} s', self.duration_s, 's'),
                   'frames': KeyFigure(str(frames), frames, '')}
        if frames:
            percent = 100 * attitudes / frames
            figures['with attitude'] = KeyFigure(
                f'{percent:.2f} %', percent, '%', low=percent < _MOST_FRAMES_PERCENT)
        _, error, _ = recording.errors()
        for kind, values in (('error', error), ('1 sigma', recording.sigma_arcsec())):
            values = values[np.isfinite(values).all(axis=1)]
            if len(values):
                for axis, rms in (('cross-boresight', _rms(values[:, :2])),
                                  ('roll', _rms(values[:, 2]))):
                    figures[f'{axis} {kind}, rms'] = KeyFigure(f'{rms:.3g} arcsec', rms, 'arcsec')
        bound = recording.protection_rad[~np.isnan(recording.protection_rad).any(axis=1)] / ARCSEC
        if len(bound):
            for axis, columns in (('cross-boresight', bound[:, :2]), ('roll', bound[:, 2:])):
                median = float(np.median(columns))
                figures[f'{axis} protection level, median'] = KeyFigure(
                    f'{median:.3g} arcsec', median, 'arcsec')
        known, beyond = recording.beyond_protection()
        if known:
            figures['errors beyond protection level'] = KeyFigure(
                str(beyond), beyond, 'frames', low=beyond > 0)
        if len(recording.tracks):
            seen = np.median(recording.tracks.count(usable(recording.tracks)))
            figures['stars used, median'] = KeyFigure(f'{seen:.0f}', float(seen), '')
        spent = {row[0]: row for row in self.latency_rows()}.get('image to attitude')
        if spent:
            figures['image to attitude, p50 / p95'] = KeyFigure(
                f'{spent[2]:.1f} / {spent[3]:.1f} ms', spent[2], 'ms', p95=spent[3])
        return figures


def usable(tracks: Clouds) -> np.ndarray:
    """Return True (N,) for tracks that are identified and were seen in their frame."""
    return (tracks.rows['hip'] > 0) & (tracks.rows['missed'] == 0)


def diagnostics_table(recording: Recording) -> list[Mapping[str, Any]]:
    """Return name, hardware_id, counts of levels, last status and distinct messages."""
    table: dict[tuple[str, str], dict[str, Any]] = {}
    for record in recording.diagnostics:
        row = table.setdefault((record.name, record.hardware_id), {
            'name': record.name, 'hardware_id': record.hardware_id, 'levels': {},
            'messages': {}})
        row['levels'][record.level] = row['levels'].get(record.level, 0) + 1
        seen = row['messages'].setdefault((record.level, record.message), [record.stamp_ns, 0])
        seen[1] += 1
        row.update(level=record.level, message=record.message, values=record.values)
    return [table[key] for key in sorted(table)]


def _error_range(error: np.ndarray, sigma: np.ndarray, bound: np.ndarray) -> list[float] | None:
    """Return low and high: the wide bounds of the first frames may leave it, no error may."""
    limit = max(4.5 * _median(sigma), 1.1 * _median(bound),
                1.1 * float(np.abs(error).max()) if len(error) else 0.0)
    return [-limit, limit] if limit else None


def _median(values: np.ndarray) -> float:
    """Return the median of the finite values, 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values ** 2)))
