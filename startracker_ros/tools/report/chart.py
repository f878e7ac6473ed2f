# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Charts of all pages and pictures, with one look: the colours of page.css, small legends, a grid.

On a page a chart is SVG that follows the reader's choice of light or dark; a picture is a PNG file
in the light colours. The browser draws the figures of the report by page.js, in the same colours.
"""

import base64
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
import re
from typing import Any

import numpy as np
from startracker_ros.core.extras import new_figure, PAGE_IN
from startracker_ros.core.stages.annotate import annotate, Labels
from startracker_ros.io.output import write_picture
from startracker_ros.io.recordings.recording import gaps_after
from startracker_ros.tools.report.template import resource

_CHART_IN = 4.6, 2.9
_COLOUR = re.compile(r'--(\w+): light-dark\((#\w{6}), (#\w{6})\);')
_MOST_INTERVALS = 1000


def _colours() -> dict[str, tuple[str, str]]:
    """Return the light and the dark colour by name: they are in the style of the pages only."""
    return {name: (light, dark) for name, light, dark in _COLOUR.findall(
        resource('startracker_ros.tools.report', 'page.css'))}


@contextmanager
def _figure(**options: Any) -> Iterator[Any]:
    """Yield a figure of matplotlib with the look of all charts; MissingLibraryError."""
    figure = new_figure(**options)
    import matplotlib
    light = {name: pair[0] for name, pair in _colours().items()}
    with matplotlib.rc_context({
            'svg.fonttype': 'none', 'svg.hashsalt': 'startracker', 'font.size': 10,
            'font.family': 'sans-serif', 'text.color': light['ink'],
            'axes.labelcolor': light['ink'], 'axes.edgecolor': light['faint'],
            'xtick.color': light['faint'], 'ytick.color': light['faint'],
            'axes.facecolor': light['card'], 'axes.grid': True, 'axes.axisbelow': True,
            'grid.color': light['rule'], 'legend.facecolor': light['card'],
            'legend.edgecolor': light['rule'], 'legend.fontsize': 9,
            'axes.formatter.useoffset': False,
            'axes.prop_cycle': f'cycler("color", {[light[f"c{k}"] for k in range(5)]})'}):
        yield figure


@contextmanager
def picture(path: str | Path, height_in: float, dpi: float, *, title: str = '', **options: Any
            ) -> Iterator[Any]:
    """
    Yield a figure as wide as a page; at the end it is written as a PNG file.

    MissingLibraryError without matplotlib, OSError where the file cannot be written.
    """
    with _figure(figsize=(PAGE_IN, height_in), **options) as figure:
        if title:
            figure.suptitle(title)
        yield figure
        write_picture(path, figure, dpi=dpi, pil_kwargs={'optimize': True})


def page_chart(draw: Callable[[Any], object]) -> str:
    """
    Return the URI of what draw(figure) draws, for a page; MissingLibraryError.

    It is so small that its text can be read on a phone.
    """
    content = BytesIO()
    with _figure(figsize=_CHART_IN) as figure:
        figure.patch.set_alpha(0)
        draw(figure)
        figure.savefig(content, format='svg', metadata={'Date': None})
    return 'data:image/svg+xml;base64,' + base64.b64encode(
        _with_both_colours(content.getvalue().decode()).encode()).decode()


def _with_both_colours(svg: str) -> str:
    """Return an SVG whose colours are those that the reader prefers."""
    colours = _colours()
    for name, (light, _) in colours.items():
        svg = svg.replace(light, f'var(--{name})')
    light, dark = (':root{' + ''.join(
        f'--{name}:{pair[which]};' for name, pair in colours.items()) + '}' for which in (0, 1))
    style = f'{light}@media (prefers-color-scheme:dark){{{dark}}}'
    return re.sub('(<svg [^>]*>)', rf'\1<style>{style}</style>', svg, count=1)


# --- kinds of charts ---


def draw_error(axes: Any, time_s: np.ndarray, error: np.ndarray, sigma: np.ndarray, *,
               label: str = 'error', band: str = '3 sigma', style: str = '.',
               colour: str = 'C0') -> None:
    """
    Draw errors (N,) over time_s (N,) on axes of matplotlib, between their 3 sigma bounds.

    Nothing is drawn over a gap of the times.
    """
    gaps = gaps_after(time_s) + 1
    band_s, three = np.insert(time_s, gaps, time_s[gaps]), np.insert(3 * sigma, gaps, np.nan)
    axes.fill_between(band_s, -three, three, color=colour, alpha=0.15, label=band, linewidth=0)
    axes.plot(time_s, error, style, color=colour, label=label, markersize=2.5)


def draw_errors(places: Sequence[Any], time_s: np.ndarray, error: np.ndarray, sigma: np.ndarray,
                names: Sequence[str], unit: str, title: str) -> list[Any]:
    """
    Draw errors (N, K) of K names with their sigmas, one below the other, at places of a grid.

    Return the axes, which share their time. The wide bounds of the first frames may leave them,
    no error may.
    """
    drawn: list[Any] = []
    for place, name, values, sigmas in zip(places, names, error.T, sigma.T):
        axes = place.get_gridspec().figure.add_subplot(place, sharex=drawn[0] if drawn else None)
        draw_error(axes, time_s, values, sigmas)
        axes.axhline(0, color='black', linewidth=0.5)
        axes.set_ylabel(f'{name}\n[{unit}]')
        if len(values):
            limit = max(4.5 * np.nanmedian(sigmas), 1.1 * np.abs(values).max())
            axes.set_ylim(-limit, limit)
        drawn.append(axes)
    for axes in drawn[:-1]:
        axes.tick_params(labelbottom=False)
    # A legend would lie over the errors.
    drawn[0].set_title(f'{title}; band: 3 sigma', loc='left')
    return drawn


def draw_series(axes: Any, stamps_ns: np.ndarray, values: np.ndarray, names: Sequence[str],
                unit: str) -> None:
    """
    Draw columns of values (N, K) over UTC, on axes of matplotlib.

    A long series is cut into intervals: a point is the middle of one, a band its extremes.
    """
    # Imported only here: the extra is not needed without a chart.
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
    if len(stamps_ns):
        begins = np.unique(np.linspace(0, len(stamps_ns), min(
            _MOST_INTERVALS, len(stamps_ns)) + 1).astype(int)[:-1])
        moments = stamps_ns[begins].astype('datetime64[ns]')
        for column, name in zip(values.T, names):
            low, high = (each.reduceat(column, begins) for each in (np.minimum, np.maximum))
            line, = axes.plot(moments, (low + high) / 2, '.-', linewidth=0.8, markersize=2,
                              label=name)
            axes.fill_between(moments, low, high, alpha=0.3, color=line.get_color(), linewidth=0)
        axes.xaxis.set_major_locator(AutoDateLocator(maxticks=5))
        axes.xaxis.set_major_formatter(ConciseDateFormatter(axes.xaxis.get_major_locator()))
    axes.set(xlabel='UTC', ylabel=f'[{unit}]')


def draw_field(axes: Any, image: np.ndarray, uv: np.ndarray, hip: np.ndarray, title: str, *,
               bare: np.ndarray = np.empty((0, 2))) -> None:
    """Draw an image (H, W) with its stars, half a page wide; no label is on a pixel of bare."""
    labels = Labels(image.shape, np.vstack([uv, bare]), share=0.5)
    axes.imshow(annotate(image, uv, hip, labels=labels))
    axes.grid(visible=False)
    axes.set(xlabel='u [px]', ylabel='v [px]', title=title)
