# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The report: one page of HTML that holds everything it shows and fetches nothing.

All that comes from a bag is escaped by the template page.html.j2, or goes through json_block()
into a block of data that scripts read with textContent. A policy in the head lets the browser run
and apply what was written here, by its hash, and nothing else.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.catalog.deep import star_name
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.output import write_output
from startracker_ros.io.recordings.frames import frame_pictures, FramePicture
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.io.table import Result
from startracker_ros.tools.report.heads import head_states, load_heads, mount_panels
from startracker_ros.tools.report.panels import diagnostics_table, Panel, Panels
from startracker_ros.tools.report.sky_map import sky_map
from startracker_ros.tools.report.template import content_policy, resource, template

_LEVELS = {0: ('OK', 'good'), 1: ('WARN', 'warn'), 2: ('ERROR', 'bad'), 3: ('STALE', 'other')}
_NAMED_STARS = 12
# Width of six digits of a number, in sizes of a mark.
_NAME_SIZES = 11.0
_PACKAGE = 'startracker_ros.tools.report'
_LISTED = 60


def write_report(bag: Path, output: Path, namespace: str | None = None) -> Result:
    """
    Write the page of a bag and return its key figures.

    BagError when the bag cannot be read, OSError when the page cannot be written,
    MissingLibraryError without Jinja2.
    """
    if not bag.exists():
        raise BagError(f'{bag} does not exist')
    panels = Panels(load_recording(bag, namespace))
    write_output(output, render_page(bag, panels))
    rows = [{'case': name, 'ours': figure.text, 'value': figure.value, 'unit': figure.unit,
             'p95': figure.p95} for name, figure in panels.key_figures().items()]
    problems = {'problem' if index == 0 else f'problem {index + 1}': problem
                for index, problem in enumerate(panels.recording.problems)}
    return Result('report', rows, {'page': str(output), **problems},
                  details=('value', 'unit', 'p95'))


def render_page(bag: Path, panels: Panels) -> str:
    """Return the HTML of a recording; pictures of frames are read from the bag."""
    recording = panels.recording
    pictures, why_no_frames = frame_pictures(bag, recording)
    groups = {name: [panel for panel in getattr(panels, name)() if _drawn(panel)]
              for name in ('attitude', 'errors', 'stars', 'residuals', 'latency')}
    heads = load_heads(bag, recording.namespace, tolerant=not recording.complete)
    groups['mounts'] = mount_panels(panels, heads) if heads else []
    head_rows = head_states(panels, heads) if heads else []
    sky, histograms, states = sky_map(panels), panels.histograms(), panels.states()
    data = {'duration': panels.duration_s, 'panels': sum(groups.values(), []), 'states': states,
            'heads': head_rows, 'histograms': histograms, 'sky': sky}
    style, script = (resource(_PACKAGE, name) for name in ('page.css', 'page.js'))
    page = template(_PACKAGE, 'page.html.j2', degrees=np.degrees, utc=utc, levels=_LEVELS,
                    listed=_LISTED)
    return page.render(
        title=f'Star tracker: {_bag_name(bag)}', policy=content_policy(style, script),
        style=style, script=script,
        data=json_block(data), panels=panels, recording=recording, groups=groups, states=states,
        heads=head_rows,
        histograms=histograms, sky=sky, no_truth=_no_truth(recording),
        error_count=len(recording.errors()[0]),
        has_covariance=np.isfinite(recording.sigma_arcsec()).any(),
        latency=[(name, count, *(f'{value:.2f}' for value in values))
                 for name, count, *values in panels.latency_rows()],
        frames=[_frame(panels, picture) for picture in pictures], why_no_frames=why_no_frames,
        diagnostics=diagnostics_table(recording), topics=_topics(panels))


def _bag_name(bag: Path) -> str:
    """Return the name of a bag, with that of its folder where it is just called bag."""
    bag = bag.resolve()
    return f'{bag.parent.name}/{bag.name}' if bag.stem in ('bag', 'bag_0') else bag.name


def json_block(data: Any) -> str:
    """Return JSON that cannot end the script element that it stands in."""
    return json.dumps(data, separators=(',', ':'), allow_nan=False).replace('<', '\\u003c')


def _drawn(panel: Panel) -> bool:
    return any(len(series['t']) for series in panel['series'])


def _no_truth(recording: Recording) -> str:
    topic = recording.full_name('truth/attitude')
    if len(recording.truth_ns):
        return f'No frame has both an attitude and a truth ({topic}): the error is not known.'
    return f'The bag holds no truth ({topic}): the error is not known.'


def _frame(panels: Panels, picture: FramePicture) -> dict[str, Any]:
    """Return what the template shows of a frame: picture, time, marks of stars, caption."""
    marks = picture.marks
    names = marks.dtype.names or ()
    hips = marks['hip'] if 'hip' in names else np.zeros(len(marks), int)
    named = set(np.argsort(-marks['flux'])[:_NAMED_STARS].tolist())
    shown, size = [], max(picture.width, picture.height) / 100
    for index, row in enumerate(marks):
        hip = int(hips[index])
        missed = 'missed' in names and row['missed'] > 0
        words = f'{star_name(hip)}, V {row["magnitude"]:.2f}' if hip else 'not identified'
        u, v = float(row['u']) + 0.5, float(row['v']) + 0.5
        # Left of a star at the right edge, below the upper edge: no number is cut.
        left = u + (1.6 + _NAME_SIZES) * size > picture.width
        shown.append({
            'u': u, 'v': v, 'anchor': 'end' if left else 'start',
            'x': u - 1.6 * size if left else u + 1.6 * size, 'y': max(v, 3 * size),
            'kind': 'mark lost' if missed else 'mark known' if hip else 'mark',
            'words': words + (', not seen in this frame' if missed else ''),
            'name': str(hip) if hip and index in named else ''})
    known = int(np.count_nonzero(hips))
    return {
        'picture': picture, 'time_s': (picture.stamp_ns - panels.start_ns) / 1e9,
        'size_px': size, 'marks': shown,
        'words': f'{len(marks)} {picture.source}, {known} identified' if picture.source else
                 'the bag holds no stars of this frame'}


def _topics(panels: Panels) -> list[tuple[str, str, int, str]]:
    """Return name, type, number of messages and rate of each topic."""
    return [(name[:300], topic.type_name[:300], topic.message_count,
             f'{topic.message_count / panels.duration_s:.2f}' if panels.duration_s else '-')
            for name, topic in sorted(panels.recording.topics.items())]
