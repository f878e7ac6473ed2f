# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of a data sheet: one file of HTML with its tables and pictures."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.evaluation.datasheet.by_rate import lines_of, number, rates_of
from startracker_ros.evaluation.datasheet.estimates import AXES
from startracker_ros.evaluation.datasheet.instrument import Instrument
from startracker_ros.evaluation.datasheet.published import PUBLISHED
from startracker_ros.evaluation.datasheet.rows import SheetRow, SplitErrors
from startracker_ros.evaluation.datasheet.sky_coverage import SkyFields, star_counts
from startracker_ros.io.output import write_output
from startracker_ros.tools.report.chart import chart
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
    page = template(_PACKAGE, 'page.html.j2', number=number)
    lens, sections = sheet.instrument.lens, []
    for name, group in groupby(lines_of(sheet.rows), key=lambda line: line.section):
        # Those at several rates, then those without one: no empty columns.
        lines = [*group]
        tables = ([line for line in lines if None not in line.rows],
                  [line for line in lines if None in line.rows])
        sections.append((name, [(rates_of(chosen), chosen) for chosen in tables if chosen]))
    text = page.render(
        title=f'Data sheet: {np.degrees(lens.fov_x_rad):.3g} deg, {lens.width} x {lens.height} px',
        style=style, policy=content_policy(style), conditions=sheet.conditions,
        published_rows=[(unit.unit, unit.sigma, *map(number, (
            unit.cross_arcsec, unit.about_arcsec, unit.rate_deg_s, unit.update_hz,
            unit.acquisition_s)), unit.source) for unit in PUBLISHED],
        pictures=[*_pictures(sheet)], sections=sections)
    write_output(output, text)


def _pictures(sheet: SheetPage) -> Iterator[tuple[str, str]]:
    """Yield captions and pictures."""
    for axis in AXES:
        yield (f'Error of a single image {axis} over the rate, 1 sigma',
               chart(partial(_draw_errors, sheet=sheet, axis=axis)))
    yield (f'Stars to V {sheet.limit:.2f} in each of {len(sheet.fields.stars)} random fields over '
           'right ascension, which grows to the left from -180 deg at the right edge to 180 deg, '
           'and declination; crosses: not identified from one image',
           chart(partial(_draw_sky, sheet=sheet)))
    yield ('Sky with enough stars over the magnitude limit',
           chart(partial(_draw_coverage, sheet=sheet)))


def _draw_errors(figure: Any, sheet: SheetPage, axis: str) -> None:
    rates_deg_s = [each.rate_deg_s for each in sheet.errors]
    panel = figure.add_subplot()
    by_rate = [each.estimates(AXES[axis]) for each in sheet.errors]
    for name in by_rate[0]:
        found = [each[name] for each in by_rate]
        value, low, high = np.array([each[:3] for each in found]).T
        panel.errorbar(
            rates_deg_s, value, [np.maximum(value - low, 0), np.maximum(high - value, 0)],
            label=name, marker='o', markersize=3, capsize=2)
        if found[0].bound is not None:
            panel.plot(rates_deg_s, [each.bound for each in found], ':', color='C4',
                       label='Cramer-Rao bound of the noise')
    panel.set(xlabel='rate across the boresight [deg/s]', ylabel='error [arcsec]', yscale='log')
    # Beside the curves, not over them.
    figure.legend(loc='outside upper center', ncols=2)


def _draw_sky(figure: Any, sheet: SheetPage) -> None:
    fields = sheet.fields
    panel = figure.add_subplot(projection='mollweide')
    # Right ascension grows to the left, as on the sky.
    longitude = -((fields.ra_rad + np.pi) % (2 * np.pi) - np.pi)
    points = panel.scatter(longitude, fields.dec_rad, c=fields.stars, s=4, cmap='viridis',
                           vmax=float(np.percentile(fields.stars, 99)), rasterized=True)
    lost = ~fields.correct
    panel.plot(longitude[lost], fields.dec_rad[lost], 'rx', markersize=6)
    panel.set_xticklabels([])
    panel.set_yticks(np.radians([-60, -30, 0, 30, 60]))
    figure.colorbar(points, orientation='horizontal', shrink=0.8, label='stars in the field')


def _draw_coverage(figure: Any, sheet: SheetPage) -> None:
    panel = figure.add_subplot()
    limits = np.arange(min(3.0, sheet.limit), sheet.limit + 0.05, 0.1)
    for least in _LEAST_STARS:
        share = [100 * np.mean(star_counts(sheet.magnitudes, limit) >= least) for limit in limits]
        panel.plot(limits, share, label=f'{least} stars or more')
    panel.axvline(sheet.limit, color='grey', linestyle=':', label='limiting magnitude')
    panel.set(xlabel='faintest star, V [mag]', ylabel='share of the sky [%]')
    figure.legend(loc='outside upper center', ncols=2)
