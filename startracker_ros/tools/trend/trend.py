"""The command trend: drifts and steps of a run, as rows and as a page."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.extras import new_figure
from startracker_ros.io.output import write_output
from startracker_ros.io.table import Result
from startracker_ros.tools.reprocess.compare import extremes
from startracker_ros.tools.reprocess.runs import open_run
from startracker_ros.tools.trend.pixels import hot_pixels, PixelRow
from startracker_ros.tools.trend.series import all_series, distortion, Series
from startracker_ros.tools.trend.stars import bad_stars, StarRow
from startracker_ros.tools.trend.steps import drift, find_steps, Step, StepSearch
from startracker_ros.tools.trend.widths import width_maps, WidthMap


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

    BagError where the folder is no run; OSError where the page cannot be written.
    """
    run = open_run(folder)
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
    if page is not None:
        write_output(page, trend_page(folder.name, found, rows, stars, pixels, maps))
    return Result('trend', rows, {
        'orbit_s': orbit_s, 'steps': sum(len(search.steps) for _, search in found),
        'stars with a fault': ', '.join(
            f'{star.hip} ({star.faults})' for star in stars[:10]) or 'none',
        'hot pixels': ', '.join(
            f'{pixel.tracker} {pixel.u} {pixel.v}' for pixel in pixels[:10]) or 'none'})


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
               maps: Sequence[WidthMap]) -> str:
    """Return one HTML page without scripts: its size does not grow with the frames."""
    pictures = ''.join(f'<h2>{escape(series.name)}</h2>{_picture(series, search.steps)}'
                       for series, search in found)
    if maps:
        pictures += f'<h2>Width of star images over the image</h2>{_map_picture(maps)}'
    return ('<!doctype html><html lang="en"><head><meta charset="utf-8">'
            f'<title>Trend of {escape(name)}</title><style>{_STYLE}</style></head><body>'
            f'<h1>Trend of {escape(name)}</h1>{_table(rows)}{pictures}'
            f'<h2>Stars with a fault</h2>{_table(stars[:_MOST_ROWS])}'
            f'<h2>Hot pixels</h2>{_table(pixels[:_MOST_ROWS])}</body></html>\n')


_MOST_ROWS = 200
_MOST_MAPS, _MAPS_IN_LINE = 24, 6
_STYLE = ('body{font:15px sans-serif;max-width:60em;margin:1em auto}td,th{padding:.2em .6em;'
          'text-align:left}img{max-width:100%}')


def _table(rows: Sequence[Any]) -> str:
    if not rows:
        return '<p>none</p>'
    records = Result('', rows).records
    head = ''.join(f'<th>{escape(name)}</th>' for name in records[0])
    body = ''.join('<tr>' + ''.join(f'<td>{escape(_cell(value))}</td>'
                                    for value in record.values()) + '</tr>' for record in records)
    return f'<table><tr>{head}</tr>{body}</table>'


def _cell(value: object) -> str:
    if value is None:
        return ''
    return f'{value:.5g}' if isinstance(value, float) else str(value)


def _picture(series: Series, steps: Sequence[Step]) -> str:
    """Return an image of the extremes of each interval, with the dates of the steps."""
    figure = new_figure(figsize=(9, 2.6))
    axes = figure.subplots()
    for column, name in enumerate(series.columns):
        times, low, high = extremes(series.stamp_ns, series.values[:, column])
        axes.fill_between(times.astype('datetime64[ns]'), low, high, alpha=0.5, label=name)
        axes.plot(times.astype('datetime64[ns]'), (low + high) / 2, linewidth=0.8)
    for step in steps:
        axes.axvline(np.datetime64(step.stamp_ns, 'ns'), color='red', linewidth=0.8)
    axes.set_ylabel(series.unit)
    axes.legend(loc='upper right')
    return _image(figure, series.name)


def _map_picture(maps: Sequence[WidthMap]) -> str:
    """Return an image of the newest maps of width, with one scale of colours."""
    shown = maps[-_MOST_MAPS:]
    lines = -(-len(shown) // _MAPS_IN_LINE)
    figure = new_figure(figsize=(9, 2.4 * lines))
    axes = figure.subplots(lines, _MAPS_IN_LINE, squeeze=False).ravel()
    known = np.concatenate([one.width_px[np.isfinite(one.width_px)] for one in shown])
    limits = np.percentile(known, (1, 99)) if len(known) else (0.0, 1.0)
    for one, at in zip(shown, axes):
        picture = at.imshow(one.width_px, vmin=limits[0], vmax=limits[1])
        at.set_title(f'{one.tracker} {one.month}', fontsize=8)
    for at in axes:
        at.set_axis_off()
    figure.colorbar(picture, ax=axes.tolist(), label='px, 1 sigma')
    return _image(figure, 'width of star images')


def _image(figure: Any, name: str) -> str:
    data = BytesIO()
    figure.savefig(data, dpi=90, format='png')
    return (f'<img alt="{escape(name)}" '
            f'src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">')
