# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command trend: drifts and steps of a run, as rows and as a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.output import write_output
from startracker_ros.io.table import Result
from startracker_ros.tools.report.chart import draw_series, page_chart
from startracker_ros.tools.report.template import render_page
from startracker_ros.tools.reprocess.run import ERRORS
from startracker_ros.tools.reprocess.tables import GRID, open_run, Run, width_px
from startracker_ros.tools.trend.series import all_series, distortion, Series
from startracker_ros.tools.trend.steps import drift, find_steps, Step, StepSearch

LEAST_FRAMES = 100
"""Frames of a star that is held against its catalogue entry."""

_POSITION_SIGMAS = 6.0
_LARGEST_DIFFERENCE_MAG = 0.3
_LARGEST_SCATTER_MAG = 0.15

LEAST_STARS = 100
"""Stars of a cell whose width is known, to 5 %."""

MIDDLE = slice(GRID // 4, GRID - GRID // 4)


@dataclass(frozen=True)
class PixelRow:
    """A hot pixel: the frames that have it, and the begins of its first and last segment."""

    tracker: str
    u: int
    v: int
    frames: int
    first: str
    last: str


def hot_pixels(run: Run, tracker: str) -> list[PixelRow]:
    """Return the hot pixels of a tracker, those of most frames first."""
    table = run.table('hot_pixels', tracker, ['stamp_ns', 'u', 'v', 'count'])
    if not len(table['stamp_ns']):
        return []
    pixels, first, which = np.unique(np.stack([table['u'], table['v']], -1), axis=0,
                                     return_index=True, return_inverse=True)
    which = which.ravel()
    frames = np.bincount(which, table['count']).astype(int)
    last = np.zeros(len(pixels), np.int64)
    np.maximum.at(last, which, table['stamp_ns'])
    return [PixelRow(tracker, int(pixels[k, 0]), int(pixels[k, 1]), int(frames[k]),
                     utc(int(table['stamp_ns'][first[k]])), utc(int(last[k])))
            for k in np.argsort(-frames, kind='stable')]


@dataclass(frozen=True)
class StarRow:
    """One star: mean residual to east and north, scatter over its errors, magnitude, faults."""

    hip: int
    magnitude: float
    frames: int
    east_arcsec: float
    north_arcsec: float
    scatter_over_sigma: float
    difference_mag: float
    scatter_mag: float
    faults: str


def bad_stars(run: Run) -> list[StarRow]:
    """Return the stars with a fault in any tracker, the worst position first."""
    columns = ('hip', 'magnitude', 'count', 'weight', 'east', 'north', 'chi2', 'difference_mag',
               'square_mag2')
    tables = [run.table('stars', tracker, ['stamp_ns', *columns]) for tracker in run.trackers]
    joined = {name: np.concatenate([table[name] for table in tables]) for name in columns}
    hip, first, which = np.unique(joined['hip'], return_index=True, return_inverse=True)
    sums = {name: np.bincount(which, joined[name], len(hip)) for name in columns[2:]}
    many = sums['count'] >= LEAST_FRAMES
    sums = {name: column[many] for name, column in sums.items()}
    hip, magnitude = hip[many], joined['magnitude'][first][many]
    east, north = sums['east'] / sums['weight'], sums['north'] / sums['weight']
    scatter = np.sqrt(sums['chi2'] / (2 * sums['count']))
    difference = sums['difference_mag'] / sums['count']
    scatter_mag = np.sqrt(np.maximum(sums['square_mag2'] / sums['count'] - difference ** 2, 0))
    # What the lens leaves to all stars is not a fault of one.
    floor = SIGMA_PER_MAD * float(np.median(np.abs(np.stack([east, north])))) if len(hip) else 0.0
    sigma = np.hypot(1 / np.sqrt(sums['weight']), floor)
    offset = np.hypot(east, north)
    rows = []
    for k in np.argsort(-offset):
        faults = [text for text, found in (
            ('position', offset[k] > _POSITION_SIGMAS * sigma[k]),
            ('scatter', scatter[k] > 2.0),
            ('magnitude', abs(difference[k]) > _LARGEST_DIFFERENCE_MAG),
            ('variable', scatter_mag[k] > _LARGEST_SCATTER_MAG)) if found]
        if faults:
            rows.append(StarRow(
                int(hip[k]), float(magnitude[k]), int(sums['count'][k]), float(east[k]),
                float(north[k]), float(scatter[k]), float(difference[k]),
                float(scatter_mag[k]), ', '.join(faults)))
    return rows


@dataclass(frozen=True)
class WidthMap:
    """
    The widths of star images in a month, 1 sigma in px.

    width_px (GRID, GRID) by row and column of the cells, NaN with fewer than LEAST_STARS; middle
    and edge are those of the middle half of both axes and of the rest, with their 1 sigma.
    """

    tracker: str
    month: str
    width_px: np.ndarray
    middle: tuple[float, float]
    edge: tuple[float, float]


def width_maps(run: Run, tracker: str) -> list[WidthMap]:
    """Return the map of each month of a tracker."""
    table = run.table('widths', tracker, ['stamp_ns', 'column', 'row', 'count', 'square_px2'])
    months = table['stamp_ns'].astype('datetime64[ns]').astype('datetime64[M]')
    maps = []
    for month in np.unique(months):
        chosen = months == month
        cell = (table['row'][chosen].astype(int) * GRID + table['column'][chosen])
        count, square = (np.bincount(cell, table[name][chosen], GRID ** 2).reshape(GRID, GRID)
                         for name in ('count', 'square_px2'))
        middle = np.zeros((GRID, GRID), bool)
        middle[MIDDLE, MIDDLE] = True
        with np.errstate(invalid='ignore', divide='ignore'):
            width = np.where(count >= LEAST_STARS, np.sqrt(square / count), np.nan)
        maps.append(WidthMap(tracker, str(month), width, *(
            width_px(float(square[part].sum()), int(count[part].sum()))
            for part in (middle, ~middle))))
    return maps


@dataclass(frozen=True)
class TrendRow:
    """A drift, or a step: what, when, size with its 1 sigma, and its significance."""

    series: str
    kind: str
    utc: str
    size: float
    sigma: float | None
    unit: str
    significance: float | None


def trend(folder: Path, page: Path | None, orbit_s: float) -> Result:
    """
    Return a row for each drift and step of a run, and write a page of its series.

    The note of the result, and of the page, names series without data and bags of the same times.
    BagError where the folder is not a run or without frames; OSError where the page cannot be
    written.
    """
    run = open_run(folder)
    if not run.days:
        raise BagError(f'{folder}: the run has no frames, see {ERRORS}')
    found = [(series, find_steps(series.stamp_ns, series.values, orbit_s))
             for series in all_series(run)]
    rows = [row for series, search in found for row in drift_rows(series, search)]
    for series, _ in found:
        rows += _month_rows(series) if series.name.endswith('zero point') else []
    for tracker in run.trackers:
        change, sigma = distortion(run, tracker)
        rows.append(TrendRow(f'{tracker} distortion', 'k1 minus camera_info', '', change, sigma,
                             '1', None))
    stars = bad_stars(run)
    pixels = [row for tracker in run.trackers for row in hot_pixels(run, tracker)]
    maps = [one for tracker in run.trackers for one in width_maps(run, tracker)]
    rows += _width_rows(maps)
    same = [remark for tracker in run.trackers if (remark := run.same_times(tracker))]
    if page is not None:
        write_output(page, trend_page(folder.name, found, rows, stars, pixels, maps, same))
    notes = same + _too_little(found)
    return Result('trend', rows, {
        'orbit_s': orbit_s, 'steps': sum(len(search.steps) for _, search in found),
        'stars with a fault': ', '.join(
            f'{star.hip} ({star.faults})' for star in stars[:10]) or 'none',
        'hot pixels': ', '.join(
            f'{pixel.tracker} {pixel.u} {pixel.v}' for pixel in pixels[:10]) or 'none',
        **({'note': '; '.join(notes)} if notes else {})})


def drift_rows(series: Series, search: StepSearch) -> list[TrendRow]:
    """
    Return the drift of each column and the smallest step that is found, then the steps.

    Of each step the column that shows it best.
    """
    slope = drift(series.stamp_ns, series.values, search.steps)
    rows = [row for column in range(len(slope)) for row in (
        TrendRow(_name(series, column), 'drift', '', float(slope[column]), None,
                 f'{series.unit}/d', None),
        TrendRow(_name(series, column), 'smallest step found', '', float(search.least[column]),
                 None, series.unit, None))]
    for step in sorted(search.steps, key=lambda step: step.stamp_ns):
        column = int(np.argmax(np.abs(step.size) / step.sigma))
        rows.append(TrendRow(
            _name(series, column), 'step', utc(step.stamp_ns), float(step.size[column]),
            float(step.sigma[column]), series.unit, step.significance))
    return rows


def _month_rows(series: Series) -> list[TrendRow]:
    """Return the median of each month, with its standard error."""
    months = series.stamp_ns.astype('datetime64[ns]').astype('datetime64[M]')
    rows = []
    for month in np.unique(months):
        values = series.values[months == month, 0]
        sigma = np.std(values) * np.sqrt(np.pi / 2 / len(values))
        rows.append(TrendRow(series.name, 'median of the month', str(month),
                             float(np.median(values)), float(sigma), series.unit, None))
    return rows


def _width_rows(maps: Sequence[WidthMap]) -> list[TrendRow]:
    """Return the widths of star images in the middle and at the edge of the image, by month."""
    return [TrendRow(f'{one.tracker} width of star images', part, one.month, width, sigma, 'px',
                     None)
            for one in maps for part, (width, sigma) in (('middle', one.middle),
                                                         ('edge', one.edge))]


def _name(series: Series, column: int) -> str:
    return (f'{series.name}, {series.columns[column]}' if len(series.columns) > 1
            else series.name)


def trend_page(name: str, found: Sequence[tuple[Series, StepSearch]], rows: Sequence[TrendRow],
               stars: Sequence[StarRow], pixels: Sequence[PixelRow],
               maps: Sequence[WidthMap], notes: Sequence[str] = ()) -> str:
    """Return one HTML page without scripts: its size does not grow with the frames."""
    shown = [(series, search) for series, search in found if len(series.stamp_ns) >= _LEAST_BINS]
    pictures = [(f'{series.name} [{series.unit}]', page_chart(
        partial(_draw, series=series, steps=search.steps)))
        for series, search in shown]
    if maps:
        pictures.append(('width of star images over the image [px, 1 sigma]',
                         page_chart(partial(_draw_maps, maps=maps))))
    stamps = np.concatenate([series.stamp_ns for series, _ in found] or [np.empty(0)])
    return render_page(
        'startracker_ros.tools.trend', title=f'Trend of {name}',
        span=f'{utc(int(stamps.min()))} to {utc(int(stamps.max()))} UTC.' if len(stamps) else '',
        rows=_table(rows), stars=_table(stars[:_MOST_ROWS]), pixels=_table(pixels[:_MOST_ROWS]),
        pictures=pictures, missing=[*notes, *_too_little(found)])


def _too_little(found: Sequence[tuple[Series, StepSearch]]) -> list[str]:
    """Return which series are too short to be drawn."""
    return [f'{series.name}: too little data, {len(series.stamp_ns)} bins of a minute, '
            f'{_LEAST_BINS} are drawn' for series, _ in found
            if len(series.stamp_ns) < _LEAST_BINS]


_LEAST_BINS = 10
_MOST_ROWS = 200
_MOST_MAPS, _MAPS_IN_LINE = 12, 3


def _table(rows: Sequence[Any]) -> tuple[list[str], list[list[str]], list[int]]:
    """Return heads, cells and the numbers of the columns of figures."""
    records = Result('', rows).records
    heads = list(records[0]) if records else []
    numbers = [column for column, name in enumerate(heads)
               if any(isinstance(record[name], (int, float)) for record in records)]
    return heads, [[_cell(value) for value in record.values()] for record in records], numbers


def _cell(value: object) -> str:
    if value is None:
        return ''
    return f'{value:.5g}' if isinstance(value, float) else str(value)


def _draw(figure: Any, series: Series, steps: Sequence[Step]) -> None:
    """Draw the extremes of each interval, with the dates of the steps."""
    axes = figure.subplots()
    draw_series(axes, series.stamp_ns, series.values, series.columns, series.unit)
    for step in steps:
        axes.axvline(np.datetime64(step.stamp_ns, 'ns'), color='red', linewidth=0.8)
    if len(series.columns) > 1:
        axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1), ncols=len(series.columns))


def _draw_maps(figure: Any, maps: Sequence[WidthMap]) -> None:
    """Draw the newest maps of width, with one scale of colours."""
    shown = maps[-_MOST_MAPS:]
    lines = -(-len(shown) // _MAPS_IN_LINE)
    axes = figure.subplots(lines, min(len(shown), _MAPS_IN_LINE), squeeze=False).ravel()
    known = np.concatenate([one.width_px[np.isfinite(one.width_px)] for one in shown])
    limits = np.percentile(known, (1, 99)) if len(known) else (0.0, 1.0)
    for one, at in zip(shown, axes):
        picture = at.imshow(one.width_px, vmin=limits[0], vmax=limits[1])
        at.set_title(f'{one.tracker}\n{one.month}', fontsize=9)
    for at in axes:
        at.set_axis_off()
    figure.colorbar(picture, ax=axes.tolist(), label='px, 1 sigma')
