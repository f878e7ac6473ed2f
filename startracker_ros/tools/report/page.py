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
from startracker_ros.core.astro.epoch import catalogue_epoch, utc
from startracker_ros.core.catalog.deep import load_deep_catalog, NUMBER_OFFSET, star_name
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.reader import read_rates_hz
from startracker_ros.io.output import write_output
from startracker_ros.io.recordings.frames import frame_pictures, FramePicture
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.io.table import Result
from startracker_ros.tools.report.heads import head_states, load_heads, mount_panels
from startracker_ros.tools.report.panels import (
    diagnostics_table, numbers, Panel, Panels, thinned, usable)
from startracker_ros.tools.report.template import render_page, resource

_LEVELS = {0: ('OK', 'good'), 1: ('WARN', 'warn'), 2: ('ERROR', 'bad'), 3: ('STALE', 'other')}
_NAMED_STARS = 12
# Width of six digits of a number, in sizes of a mark.
_NAME_SIZES = 11.0
_PACKAGE = 'startracker_ros.tools.report'
_LISTED = 60

# A wider path is drawn on a map of the whole sky.
_WIDEST_DEG = 60.0
_BACKGROUND_STARS = 500


def write_report(bag: Path, output: Path, namespace: str | None = None) -> Result:
    """
    Write the page of a bag and return its key figures.

    BagError when the bag cannot be read, OSError when the page cannot be written,
    MissingLibraryError without Jinja2.
    """
    if not bag.exists():
        raise BagError(f'{bag} does not exist')
    panels = Panels(load_recording(bag, namespace))
    write_output(output, report_page(bag, panels))
    rows = [{'case': name, 'ours': figure.text, 'value': figure.value, 'unit': figure.unit,
             'p95': figure.p95} for name, figure in panels.key_figures().items()]
    problems = {'problem' if index == 0 else f'problem {index + 1}': problem
                for index, problem in enumerate(panels.recording.problems)}
    return Result('report', rows, {'page': str(output), **problems},
                  details=('value', 'unit', 'p95'))


def report_page(bag: Path, panels: Panels) -> str:
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
    return render_page(
        _PACKAGE, {'degrees': np.degrees, 'utc': utc, 'levels': _LEVELS, 'listed': _LISTED},
        script=resource(_PACKAGE, 'page.js'), title=f'Star tracker: {_bag_name(bag)}',
        data=json_block(data), panels=panels, recording=recording, groups=groups, states=states,
        heads=head_rows, histograms=histograms, sky=sky, no_truth=_no_truth(recording),
        error_count=len(recording.errors()[0]),
        has_covariance=np.isfinite(recording.sigma_arcsec()).any(),
        latency=[(name, count, *(f'{value:.2f}' for value in values))
                 for name, count, *values in panels.latency_rows()],
        frames=[_frame(panels, picture) for picture in pictures], why_no_frames=why_no_frames,
        diagnostics=diagnostics_table(recording), topics=_topics(bag, recording))


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


def _topics(bag: Path, recording: Recording) -> list[tuple[str, str, int, str]]:
    """Return name, type, number of messages and rate of each topic."""
    rates_hz = read_rates_hz(bag)
    return [(name[:300], topic.type_name[:300], topic.message_count,
             f'{rates_hz[name]:.2f}' if name in rates_hz else '-')
            for name, topic in sorted(recording.topics.items())]


def sky_map(panels: Panels) -> dict[str, Any] | None:
    """Return path, stars, image border and centre of the map; None without an attitude."""
    recording = panels.recording
    if not len(recording.attitude_ns):
        return None
    boresight = matrix_from_quaternion(recording.quaternion)[:, :, 2]
    keep = thinned([*recording.quaternion.T])
    centre = boresight.mean(axis=0)
    length = float(np.linalg.norm(centre))
    centre = centre / length if length > 1e-6 else boresight[0]
    border = _border(panels)
    half_field = float(np.degrees(np.arccos(min(1.0, border[:, 2].min())))) if len(border) else 1.0
    off_centre = np.arccos(np.clip(boresight @ centre, -1, 1)).max()
    radius_deg = half_field + float(np.degrees(off_centre))
    whole_sky = radius_deg > _WIDEST_DEG
    return {
        't': numbers((recording.attitude_ns[keep] - panels.start_ns) / 1e9, 4),
        'q': [numbers(q, 7) for q in recording.quaternion[keep]],
        'border': [numbers(vector, 6) for vector in border],
        'centre': numbers(centre, 7), 'wholeSky': whole_sky,
        'radiusDeg': 180.0 if whole_sky else round(1.08 * radius_deg, 3),
        'stars': _stars(panels, centre, 180.0 if whole_sky else radius_deg)}


def _border(panels: Panels) -> np.ndarray:
    """Return the unit vectors (N, 3) in the sensor frame once around the image."""
    camera = panels.recording.camera
    if camera is None:
        return np.empty((0, 3))
    side = np.linspace(0, 1, 9)[:-1]
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    around = np.concatenate([a + side[:, None] * (b - a)
                             for a, b in zip(corners, np.roll(corners, -1, axis=0))])
    return camera.unproject(around * (camera.width, camera.height) - 0.5)


def _stars(panels: Panels, centre: np.ndarray, radius_deg: float) -> list[list[float | None]]:
    """Return x, y, z, V, Hipparcos number and frames in use, of those used and bright ones."""
    recording = panels.recording
    if len(recording.tracks):
        used = recording.tracks.rows['hip'][usable(recording.tracks)]
    else:
        used = recording.stars.rows['hip'][recording.stars.rows['hip'] > 0]
    hip, frames = np.unique(used, return_counts=True)
    catalog = load_deep_catalog() if hip.max(initial=0) >= NUMBER_OFFSET else load_catalog()
    in_use = dict(zip(hip.tolist(), frames.tolist()))
    directions = catalog.directions(catalogue_epoch(panels.start_ns).year)
    inside = np.flatnonzero(directions @ centre > np.cos(np.radians(min(radius_deg * 1.1, 180))))
    # Brightest first, as the catalogue is.
    shown = np.union1d(inside[:_BACKGROUND_STARS], np.flatnonzero(np.isin(catalog.hip, hip)))
    return [[*numbers(directions[star], 6), round(float(catalog.magnitude[star]), 2),
             int(catalog.hip[star]), in_use.get(int(catalog.hip[star]), 0)] for star in shown]
