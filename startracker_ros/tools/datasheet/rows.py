# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rows of a data sheet, out of what was simulated."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
import math
import re
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.integrity.protection import ProtectionOptions
from startracker_ros.tools.datasheet import estimates
from startracker_ros.tools.datasheet.estimates import AXES, bootstrapped, Estimate, rms
from startracker_ros.tools.datasheet.image_runs import DISTURBANCES
from startracker_ros.tools.datasheet.single_images import ImageErrors
from startracker_ros.tools.datasheet.sky_coverage import SkyFields, star_counts
from startracker_ros.tools.datasheet.tally import Tally
from startracker_ros.tools.datasheet.tracked_runs import RunCase, Runs
from startracker_ros.tools.figures.correctness import WRONG_SHARE
from startracker_ros.tools.figures.rows import goal_text, mean_chi_square_bounds


# --- published figures of manufacturers ---


@dataclass(frozen=True)
class PublishedUnit:
    """Errors in arcsec across and about the boresight at so many sigma, limits, source."""

    unit: str
    sigma: str
    cross_arcsec: float
    about_arcsec: float
    rate_deg_s: float | None
    update_hz: float | None
    acquisition_s: float | None
    source: str


_AURIGA = 'Sodern, Auriga brochure, p. 5, end of life, worst case'

PUBLISHED = (
    PublishedUnit('Sodern Auriga, field-of-view error', '3', 9.0, 51.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Sodern Auriga, pixel error', '3', 6.6, 38.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Sodern Auriga, temporal noise', '3', 11.0, 70.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Rocket Lab ST-16RT2', 'not stated', 5.0, 55.0, 3.0, None, None,
                  'Rocket Lab (Sinclair Interplanetary), ST-16RT2 data sheet'),
    PublishedUnit('arcsec Sagitta', '1', 2.0, 10.0, None, 10.0, None,
                  'arcsec, Sagitta Star Tracker Datasheet v2'),
    PublishedUnit('arcsec Twinkle', 'not stated', 15.0, 90.0, None, None, None,
                  'arcsec, Twinkle data sheet'),
    PublishedUnit('Blue Canyon NST', 'not stated', 6.0, 40.0, None, None, None,
                  'Blue Canyon Technologies, Nano Star Tracker data sheet'),
    PublishedUnit('Terma HE-5AS', 'not stated', 3.2, 16.0, None, None, None,
                  'Terma, HE-5AS data sheet'),
)

AURIGA_3_SIGMA_ARCSEC = {
    'field-of-view spatial error': (9.0, 51.0), 'pixel spatial error': (6.6, 38.0),
    'temporal noise': (11.0, 70.0)}
"""The rows of Auriga that a simulation has too: across and about the boresight."""

AURIGA_ACQUISITION_S, AURIGA_ACQUISITION_DEG_S, AURIGA_TRACKING_DEG_S = 3.8, 2.0, 3.0


# --- rows ---

IMAGES, TRACKER = 'images, one by one', 'images through the tracker'
CALIBRATIONS = 'calibrations and images'
STAR_LISTS, CATALOGUE = 'star lists', 'catalogue'
FORMULA, NOT_SIMULATED, THIS_MACHINE = 'closed formula', 'not simulated', 'this machine'

_OF_CALIBRATION = {'bias': estimates.bias, 'field-of-view spatial error': estimates.fov_spatial}
_OF_IMAGES = {'pixel spatial error': estimates.pixel_spatial,
              'temporal noise': estimates.temporal_noise}

TRACKED_PERCENT = 95.0
"""Share of the frames with an attitude from which on a motion counts as tracked."""

_COVERED_STARS = 4


@dataclass(frozen=True)
class SheetRow:
    """
    One figure: ours is 1 sigma or the value itself, three_sigma is 3 sigma of an error.

    low and high are its 95 % confidence interval, bound its Cramer-Rao bound, published what
    Sodern states of Auriga, at 3 sigma where there is a three_sigma. method says what it is of,
    goal what a figure should be, and whether it is.
    """

    section: str
    case: str
    ours: float | None
    unit: str
    three_sigma: float | None = None
    low: float | None = None
    high: float | None = None
    bound: float | None = None
    published: float | None = None
    method: str = IMAGES
    goal: str = ''


def mechanical_rows() -> Iterator[SheetRow]:
    """Yield what no simulation of images shows."""
    for case in ('thermo-elastic error', 'alignment to the mounting frame'):
        yield SheetRow('Not simulated', case, None, 'arcsec', method=NOT_SIMULATED)


class SplitErrors(NamedTuple):
    """
    Errors at one rate: of the images of a camera that is known exactly, and of calibrations.

    calibrations (C, F, 3) rad are the errors of F fields that each of C calibrations makes.
    """

    rate_deg_s: float
    images: ImageErrors
    calibrations: np.ndarray

    def estimates(self, axes: slice) -> dict[str, Estimate]:
        """Return the estimates by the kind of error."""
        return {**{name: estimate(self.calibrations, self.images, axes)
                   for name, estimate in _OF_CALIBRATION.items()},
                **{name: estimate(self.images, axes) for name, estimate in _OF_IMAGES.items()}}


def split_rows(errors: Sequence[SplitErrors]) -> Iterator[SheetRow]:
    """Yield the errors of single images, by their kind, rate and axis."""
    found = [[each.estimates(columns) for columns in AXES.values()] for each in errors]
    for name in (*_OF_CALIBRATION, *_OF_IMAGES):
        for each, of_axes in zip(errors, found):
            for number, (axis, one) in enumerate(zip(AXES, of_axes)):
                published = AURIGA_3_SIGMA_ARCSEC.get(name, (None, None))[number]
                yield _error_row(
                    'Error of a single image', f'{name}, {each.rate_deg_s:g} deg/s, {axis}',
                    one[name], published, CALIBRATIONS if name in _OF_CALIBRATION else IMAGES)


def _error_row(section: str, case: str, found: Estimate, published: float | None = None,
               method: str = IMAGES) -> SheetRow:
    return SheetRow(section, case, found.value, 'arcsec', 3 * found.value,
                    found.low, found.high, found.bound, published, method)


def tracked_rows(cases: Sequence[RunCase], runs: Sequence[Runs], bias_rad: np.ndarray
                 ) -> Iterator[SheetRow]:
    """Yield the error of the published attitude but for the bias (3,), and the availability."""
    section = 'Error of the published attitude'
    for case, each in zip(cases, runs):
        for axis, columns in AXES.items():
            yield _error_row(
                section, f'all errors but the bias, {case.rate_deg_s:g} deg/s, {axis}',
                bootstrapped(rms, (each.settled - bias_rad)[..., columns]), method=TRACKER)
    for case, each in zip(cases, runs):
        yield SheetRow(section, f'frames with an attitude, {case.rate_deg_s:g} deg/s',
                       each.available_percent, '%', method=TRACKER)
    counts = [each.wrong(bias_rad) for each in runs]
    yield SheetRow(section, 'wrong attitudes, all rates',
                   float(sum(count.wrong for count in counts)), 'frames', method=TRACKER)
    yield SheetRow(section, 'gross attitudes, all rates',
                   float(sum(count.gross for count in counts)), 'frames', method=TRACKER)


def consistency_rows(cases: Sequence[RunCase], runs: Sequence[Runs], bias_rad: np.ndarray
                     ) -> Iterator[SheetRow]:
    """
    Yield how true covariance and protection level are at each rate, but for the bias (3,).

    The frames of a run are correlated: the interval of the mean NEES is that of one of each run.
    """
    section = 'Consistency of the published attitude'
    low, high = mean_chi_square_bounds(3, len(runs[0].error))
    # Each axis has its own probability.
    misleading_percent = 300 * ProtectionOptions().misleading_probability
    for case, each in zip(cases, runs):
        rate = f'{case.rate_deg_s:g} deg/s'
        nees, published = each.nees(bias_rad), each.published
        if nees is not None:
            yield SheetRow(section, f'NEES, {rate}', nees, '', method=TRACKER,
                           goal=goal_text(f'{low:.2f} .. {high:.2f}', low <= nees <= high))
        for name, count, percent in (
                (f'beyond {WRONG_SIGMAS:g} sigma', each.wrong(bias_rad).wrong, 100 * WRONG_SHARE),
                ('beyond the protection level', each.beyond_protection(bias_rad),
                 misleading_percent)):
            if published:
                share = 100 * count / published
                yield SheetRow(section, f'frames {name}, {rate}', share, '%', method=TRACKER,
                               goal=goal_text(f'<= {percent:.2g}', share <= percent))


def limit_rows(cases: Sequence[RunCase], runs: Sequence[Runs], bias_rad: np.ndarray
               ) -> Iterator[SheetRow]:
    """Yield the largest rate and acceleration of the cases that the tracker follows."""
    steady = [(case.rate_deg_s, each) for case, each in zip(cases, runs)
              if not case.acceleration_deg_s2]
    faster = [(case.acceleration_deg_s2, each) for case, each in zip(cases, runs)
              if case.acceleration_deg_s2]
    section = 'Limits of the motion'
    yield SheetRow(section, 'tracking rate', _largest(steady, bias_rad), 'deg/s',
                   published=AURIGA_TRACKING_DEG_S, method=TRACKER)
    if faster:
        yield SheetRow(section, 'acceleration from rest', _largest(faster, bias_rad),
                       'deg/s^2', method=TRACKER)
    acquired = [(rate, each) for rate, each in steady
                if np.mean(each.acquired_s < AURIGA_ACQUISITION_S) >= TRACKED_PERCENT / 100]
    yield SheetRow(section, 'acquisition rate',
                   max((rate for rate, _ in acquired), default=0.0), 'deg/s',
                   published=AURIGA_ACQUISITION_DEG_S, method=TRACKER)


def _largest(runs: Sequence[tuple[float, Runs]], bias_rad: np.ndarray) -> float:
    """Return the largest value of which, and of all smaller ones, the runs were tracked."""
    tracked = 0.0
    for value, each in sorted(runs, key=lambda one: one[0]):
        if each.available_percent < TRACKED_PERCENT or each.wrong(bias_rad).wrong:
            break
        tracked = value
    return tracked


def acquisition_rows(errors: Sequence[SplitErrors], runs: Sequence[Runs], fields: SkyFields
                     ) -> Iterator[SheetRow]:
    """Yield time and probability of an acquisition, lost in space."""
    section = 'Acquisition, lost in space'
    for each, run in zip(errors, runs):
        yield SheetRow(section, f'a single image is identified, {each.rate_deg_s:g} deg/s',
                       100 * float(np.mean(each.images.identified)), '%')
        yield SheetRow(section, f'first image to first attitude, 95 % of runs, '
                       f'{each.rate_deg_s:g} deg/s',
                       float(np.percentile(run.acquired_s, 95, method='higher')), 's',
                       published=AURIGA_ACQUISITION_S, method=TRACKER)
    yield SheetRow(section, 'fields of the whole sky identified from one image',
                   100 * float(np.mean(fields.correct)), '%', method=STAR_LISTS)
    yield SheetRow(section, 'fields of the whole sky identified wrongly',
                   float(fields.wrong.sum()), 'fields', method=STAR_LISTS)
    yield SheetRow(section, 'processor time of an identification, median',
                   float(np.median(fields.time_ms)), 'ms', method=STAR_LISTS)


def coverage_rows(magnitudes: list[np.ndarray], limit: float) -> Iterator[SheetRow]:
    """Yield the share of the sky with enough stars over the magnitude limit."""
    section = 'Sky coverage'
    yield SheetRow(section, 'limiting magnitude at rest', limit, 'mag', method=FORMULA)
    for level in (*(value for value in (4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0) if value < limit),
                  limit):
        count = star_counts(magnitudes, level)
        yield SheetRow(section, f'sky with {_COVERED_STARS} stars or more, to V {level:.2f}',
                       100 * float(np.mean(count >= _COVERED_STARS)), '%', method=CATALOGUE)
    for name, share in (('fewest', 0), ('1 % of the sky has fewer', 1), ('median', 50)):
        yield SheetRow(section, f'stars in the field to V {limit:.2f}, {name}',
                       float(np.percentile(count, share)), 'stars', method=CATALOGUE)


def availability_rows(tallies: Sequence[Tally]) -> Iterator[SheetRow]:
    """Yield the share of the disturbed frames with an attitude, and the wrong ones of all."""
    section = 'Availability under disturbance'
    for disturbance, tally in zip(DISTURBANCES, tallies):
        yield SheetRow(section, disturbance.name, 100 * tally.available / max(tally.due, 1), '%',
                       method=TRACKER)
    yield SheetRow(section, 'wrong attitudes, all disturbances',
                   float(sum(tally.wrong for tally in tallies)), 'frames', method=TRACKER)
    yield SheetRow(section, 'gross attitudes, all disturbances',
                   float(sum(tally.gross for tally in tallies)), 'frames', method=TRACKER)


def speed_rows(times_ms: np.ndarray) -> Iterator[SheetRow]:
    """Yield rate and latency of the computation of frames that took times (N,)."""
    section = 'Speed'
    median_ms = float(np.median(times_ms))
    yield SheetRow(section, 'image to attitude, median', median_ms, 'ms', method=THIS_MACHINE)
    yield SheetRow(section, 'image to attitude, 95 % of frames',
                   float(np.percentile(times_ms, 95)), 'ms', method=THIS_MACHINE)
    yield SheetRow(section, 'update rate of one core', 1e3 / median_ms, 'Hz', method=THIS_MACHINE)


# --- rows as people read them: a figure in a line, the rates in columns ---

_RATE = re.compile(r', ([\d.]+) deg/s')


@dataclass(frozen=True)
class SheetLine:
    """A figure: a row at each rate in deg/s, or one row at None where it has no rate."""

    section: str
    case: str
    unit: str
    rows: dict[float | None, SheetRow] = field(default_factory=dict)

    @property
    def first(self) -> SheetRow:
        """Return the row of the lowest rate, whose method and published figure are of all."""
        return next(iter(self.rows.values()))


def lines_of(table: Sequence[SheetRow]) -> list[SheetLine]:
    """Return the lines of a table, in the order of their first rows."""
    lines: dict[tuple[str, str, str], SheetLine] = {}
    for row in table:
        found = _RATE.search(row.case)
        line = SheetLine(row.section, _RATE.sub('', row.case), row.unit)
        lines.setdefault((line.section, line.case, line.unit), line).rows[
            float(found[1]) if found else None] = row
    return list(lines.values())


def rates_of(lines: Sequence[SheetLine]) -> list[float | None]:
    """Return the rates of some lines, None first."""
    return sorted({rate for line in lines for rate in line.rows},
                  key=lambda rate: -1.0 if rate is None else rate)


def records(table: Sequence[SheetRow]) -> list[dict[str, object]]:
    """Return the rows for a terminal: at rest or without a rate, then at the other rates."""
    lines = lines_of(table)
    rates = [rate for rate in rates_of(lines) if rate]
    return [{'figure': line.case, 'unit': line.unit,
             'at rest': _cell(line.rows.get(0.0, line.rows.get(None))),
             **{f'{rate:g} deg/s': _cell(line.rows.get(rate)) for rate in rates}}
            for line in lines]


def _cell(row: SheetRow | None) -> str:
    """Return the figure of a row, with its goal where that is missed."""
    missed = row is not None and row.goal.endswith('missed')
    return f'{number(row)} ({row.goal})' if row and missed else number(row)


def number(value: SheetRow | float | None) -> str:
    """Return a figure of three digits, or that of a row; a dash where there is none."""
    if isinstance(value, SheetRow):
        value = value.ours
    if value is None or not math.isfinite(value):
        return '-'
    return f'{value:.3g}' if abs(value) < 1000 else f'{value:.0f}'
