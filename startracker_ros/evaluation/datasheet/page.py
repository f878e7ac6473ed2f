"""The page of a data sheet: one file of HTML with its tables and pictures."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import io
from itertools import groupby
import math
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.extras import new_figure
from startracker_ros.evaluation.datasheet.estimates import AXES
from startracker_ros.evaluation.datasheet.instrument import Instrument
from startracker_ros.evaluation.datasheet.published import PUBLISHED
from startracker_ros.evaluation.datasheet.rows import SheetRow, SplitErrors
from startracker_ros.evaluation.datasheet.sky_coverage import SkyFields, star_counts
from startracker_ros.io.output import write_output
from startracker_ros.tools.report.template import content_policy, resource, template

_PACKAGE = 'startracker_ros.evaluation.datasheet'
_LEAST_STARS = (4, 6, 10)


@dataclass(frozen=True)
class SheetPage:
    """What the page shows: rows, conditions, and the samples that are drawn."""

    instrument: Instrument
    rows: Sequence[SheetRow]
    conditions: Mapping[str, object]
    errors: Sequence[SplitErrors]
    magnitudes: list[np.ndarray]
    fields: SkyFields
    limit: float


def write_page(output: Path, sheet: SheetPage) -> None:
    """Write the page; OSError, or MissingLibraryError without Jinja2 or matplotlib."""
    style = resource('startracker_ros.tools.report', 'page.css')
    page = template(_PACKAGE, 'page.html.j2', number=_number)
    lens = sheet.instrument.lens
    text = page.render(
        title=f'Data sheet: {np.degrees(lens.fov_x_rad):.3g} deg, {lens.width} x {lens.height} px',
        style=style, policy=content_policy(style), conditions=sheet.conditions,
        published=PUBLISHED, pictures=[*_pictures(sheet)],
        sections=[(name, [*rows]) for name, rows in groupby(
            sheet.rows, key=lambda row: row.section)])
    write_output(output, text)


def _number(value: float | None) -> str:
    """Return a figure of three digits, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return '-'
    return f'{value:.3g}' if abs(value) < 1000 else f'{value:.0f}'


def _pictures(sheet: SheetPage) -> Any:
    """Yield captions and pictures."""
    yield 'Error of a single image over the rate, 1 sigma', _png(_draw_errors(sheet))
    yield (f'Stars to V {sheet.limit:.2f} in each of {len(sheet.fields.stars)} random fields; '
           'crosses: not identified from one image', _png(_draw_sky(sheet)))
    yield 'Sky with enough stars over the magnitude limit', _png(_draw_coverage(sheet))


def _png(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=100)
    return base64.b64encode(buffer.getvalue()).decode()


def _draw_errors(sheet: SheetPage) -> Any:
    figure = new_figure(figsize=(6, 6.5))
    rates_deg_s = [each.rate_deg_s for each in sheet.errors]
    for number, (axis, columns) in enumerate(AXES.items(), 1):
        panel = figure.add_subplot(2, 1, number)
        by_rate = [each.estimates(columns) for each in sheet.errors]
        for name in by_rate[0]:
            if name == 'bias':
                continue
            found = [each[name] for each in by_rate]
            value, low, high = np.array([each[:3] for each in found]).T
            panel.errorbar(
                rates_deg_s, value, [np.maximum(value - low, 0), np.maximum(high - value, 0)],
                label=name, marker='o', markersize=3, capsize=2)
            if found[0].bound is not None:
                panel.plot(rates_deg_s, [each.bound for each in found], 'k:',
                           label='Cramer-Rao bound of the noise')
        panel.set(ylabel=f'{axis} [arcsec]', yscale='log')
        panel.grid(alpha=0.3)
    panel.set_xlabel('rate across the boresight [deg/s]')
    figure.axes[0].legend(fontsize=8)
    return figure


def _draw_sky(sheet: SheetPage) -> Any:
    fields = sheet.fields
    figure = new_figure(figsize=(7, 4))
    panel = figure.add_subplot(projection='mollweide')
    # Right ascension grows to the left, as on the sky.
    longitude = -((fields.ra_rad + np.pi) % (2 * np.pi) - np.pi)
    points = panel.scatter(longitude, fields.dec_rad, c=fields.stars, s=4, cmap='viridis',
                           vmax=float(np.percentile(fields.stars, 99)))
    lost = ~fields.correct
    panel.plot(longitude[lost], fields.dec_rad[lost], 'rx', markersize=6)
    panel.set_xticklabels([])
    panel.grid(alpha=0.3)
    panel.set_title('right ascension from 180 deg (left) over 0 to -180 deg', fontsize=9)
    figure.colorbar(points, orientation='horizontal', shrink=0.7, label='stars in the field')
    return figure


def _draw_coverage(sheet: SheetPage) -> Any:
    figure = new_figure(figsize=(6, 4))
    panel = figure.add_subplot()
    limits = np.arange(min(3.0, sheet.limit), sheet.limit + 0.05, 0.1)
    for least in _LEAST_STARS:
        share = [100 * np.mean(star_counts(sheet.magnitudes, limit) >= least) for limit in limits]
        panel.plot(limits, share, label=f'{least} stars or more')
    panel.axvline(sheet.limit, color='grey', linestyle=':', label='limiting magnitude')
    panel.set(xlabel='faintest star, V', ylabel='share of the sky [%]')
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
    return figure
