"""
The report: one page of HTML that holds everything it shows and fetches nothing.

All that comes from a bag goes through html.escape() into the text, or through json_block() into
a block of data that scripts read with textContent. A policy in the head lets the browser run and
apply what was written here, by its hash, and nothing else.
"""

import base64
from collections.abc import Iterable, Sequence
import hashlib
from html import escape
from importlib.resources import files
import json
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.bag.errors import BagError
from startracker_ros.report.frames import frame_pictures, FramePicture
from startracker_ros.report.panels import diagnostics_table, Panel, Panels, utc
from startracker_ros.report.recording import load_recording, Recording
from startracker_ros.report.sky_map import sky_map
from startracker_ros.table import Result

_LEVELS = {0: ('OK', 'good'), 1: ('WARN', 'warn'), 2: ('ERROR', 'bad'), 3: ('STALE', 'other')}
_NAMED_STARS = 12
_LISTED = 60


def write_report(bag: Path, output: Path, namespace: str | None = None) -> Result:
    """
    Write the page of a bag and return its key figures.

    BagError when the bag cannot be read, OSError when the page cannot be written.
    """
    if not bag.exists():
        raise BagError(f'{bag} does not exist')
    panels = Panels(load_recording(bag, namespace))
    output.write_text(render_page(bag, panels), encoding='utf-8')
    rows = [{'case': name, 'ours': value} for name, value in panels.key_figures().items()]
    problems = {'problem' if index == 0 else f'problem {index + 1}': problem
                for index, problem in enumerate(panels.recording.problems)}
    return Result('report', rows, {'page': str(output), **problems})


def render_page(bag: Path, panels: Panels) -> str:
    """Return the HTML of a recording; pictures of frames are read from the bag."""
    recording = panels.recording
    pictures, why_none = frame_pictures(bag, recording)
    groups = {name: getattr(panels, name)()
              for name in ('attitude', 'errors', 'stars', 'residuals', 'latency')}
    sky = sky_map(panels)
    histograms = panels.histograms()
    states = panels.states()
    shown = [panel for group in groups.values() for panel in group if _drawn(panel)]
    data = {'duration': panels.duration_s, 'panels': shown, 'states': states,
            'histograms': histograms, 'sky': sky}
    style, script = _resource('page.css'), _resource('page.js')
    sections = [
        _section('state', 'State', _states(recording, states)),
        _section('attitude', 'Attitude', _attitude(recording, groups['attitude'])),
        _section('error', 'Attitude error', _errors(recording, groups['errors'])),
        _section('histogram', 'Error about sensor axes', _histograms(recording, histograms)),
        _section('sky-map', 'Sky', _sky(recording, sky)),
        _section('star-count', 'Stars tracked', _plots(
            groups['stars'], 'The bag holds no star lists (centroids, stars or tracks).')),
        _section('residual', 'Residuals', _plots(
            groups['residuals'], 'The bag holds no tracks and no identified stars, which carry '
            'the residuals.') + '<p class="faint">Distance of identified stars from where the '
            'tracker expects them.</p>'),
        _section('delay', 'Latency', _latency(panels, groups['latency'])),
        _section('frame', 'Frames', _frames(panels, pictures, why_none)),
        _section('diagnostic', 'Diagnostics', _diagnostics(recording)),
        _section('topic', 'Topics', _topics(panels)),
    ]
    policy = (f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; "
              f"script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'")
    title = escape(f'Star tracker: {bag.resolve().name}')
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<header>
<h1>{title}</h1>
{_introduction(panels)}
<dl class="figures">{_key_figures(panels)}</dl>
{_problems(recording)}
<nav>{_contents()}</nav>
<noscript><p class="missing">The figures are drawn by JavaScript, which is turned off here; tables
and frames are complete without it.</p></noscript>
</header>
<main>
{''.join(sections)}
</main>
<div class="bar-tools"><div>
<output id="cursor-time">no cursor</output>
<input id="cursor" type="range" min="0" max="1" step="0.001" value="0" aria-label="time cursor">
<button id="zoom-in" type="button" aria-label="zoom in">+</button>
<button id="zoom-out" type="button" aria-label="zoom out">&minus;</button>
<button id="whole" type="button" aria-label="whole run">all</button>
<button id="theme" type="button" aria-label="light or dark">&#9680;</button>
</div></div>
<script type="application/json" id="data">{json_block(data)}</script>
<script>{script}</script>
</body>
</html>
"""


def json_block(data: Any) -> str:
    """Return JSON that cannot end the script element that it stands in."""
    return json.dumps(data, separators=(',', ':'), allow_nan=False).replace('<', '\\u003c')


def _resource(name: str) -> str:
    return files('startracker_ros.report').joinpath(name).read_text(encoding='utf-8')


def _hash(text: str) -> str:
    return 'sha256-' + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


_TITLES = {
    'state': 'state', 'attitude': 'attitude', 'error': 'error', 'histogram': 'histogram',
    'sky-map': 'sky', 'star-count': 'stars', 'residual': 'residuals', 'delay': 'latency',
    'frame': 'frames', 'diagnostic': 'diagnostics', 'topic': 'topics'}


def _contents() -> str:
    return ' '.join(f'<a href="#section-{name}">{title}</a>' for name, title in _TITLES.items())


def _section(name: str, title: str, content: str) -> str:
    return f'<section id="section-{name}"><h2>{escape(title)}</h2>\n{content}</section>\n'


def _missing(text: str) -> str:
    return f'<p class="missing">{escape(text)}</p>'


def _drawn(panel: Panel) -> bool:
    return any(len(series['t']) for series in panel['series'])


def _plots(panels: Sequence[Panel], why_none: str) -> str:
    if not any(map(_drawn, panels)):
        return _missing(why_none)
    return ''.join(f'<figure class="plot" id="{escape(panel["id"])}"></figure>'
                   for panel in panels if _drawn(panel))


def _introduction(panels: Panels) -> str:
    recording = panels.recording
    camera = recording.camera
    lens = 'The bag holds no usable camera_info.' if camera is None else (
        f'Camera: {camera.width} x {camera.height} px, {np.degrees(camera.fov_x_rad):.2f} x '
        f'{np.degrees(camera.fov_y_rad):.2f} deg.')
    begin = f'{utc(panels.start_ns)} UTC.' if panels.end_ns else 'The bag holds no message.'
    where = f' Namespace: {recording.namespace}.' if recording.namespace else ''
    return (f'<p class="faint">{escape(begin)}{escape(where)} {escape(lens)} '
            'Times are seconds since then, by the stamps of the messages.</p>')


def _key_figures(panels: Panels) -> str:
    return ''.join(f'<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>'
                   for name, value in panels.key_figures().items())


def _problems(recording: Recording) -> str:
    return ''.join(_missing(problem[:1000]) for problem in recording.problems)


def _states(recording: Recording, states: Sequence[Any]) -> str:
    if not states:
        return _missing(f'The bag holds no states ({recording.full_name("tracker_state")}).')
    return ('<figure class="plot" id="states"></figure><p class="faint">States carry no stamp: '
            'their receipt is moved to the time of the frames by the median delay, '
            f'{recording.receipt_delay_ns() / 1e6:.1f} ms.</p>')


def _attitude(recording: Recording, panels: Sequence[Panel]) -> str:
    text = _plots(panels, f'The bag holds no attitude ({recording.full_name("attitude")}) and no '
                  'truth.')
    if not len(recording.attitude_ns) and len(recording.truth_ns):
        text += _missing('The bag holds no attitude: only the truth is drawn.')
    return text + ('<p class="faint">Boresight, ICRS; roll is the position angle of image up, '
                   'from celestial north through east.</p>')


def _errors(recording: Recording, panels: Sequence[Panel]) -> str:
    stamps, _, _ = recording.errors()
    text = ''
    if not len(stamps) and len(recording.attitude_ns):
        text = _missing(_no_truth(recording) + (
            ' Drawn is what the estimator says of itself.' if any(map(_drawn, panels)) else ''))
    if not np.isfinite(recording.sigma_arcsec()).any():
        text += _missing('The bag holds no covariance of the attitude (attitude_cov or '
                         'attitude_imu): there are no 3 sigma bounds.')
    if any(map(_drawn, panels)):
        text += _plots(panels, '')
    elif not text or not len(recording.attitude_ns):
        text += _missing('The bag holds no attitude.')
    return text + ('<p class="faint">Rotation from truth to attitude about the axes of the '
                   'sensor.</p>')


def _no_truth(recording: Recording) -> str:
    topic = recording.full_name('truth/attitude')
    if len(recording.truth_ns):
        return f'No frame has both an attitude and a truth ({topic}): the error is not known.'
    return f'The bag holds no truth ({topic}): the error is not known.'


def _histograms(recording: Recording, histograms: Sequence[Any]) -> str:
    if not histograms:
        return _missing(_no_truth(recording))
    return ('<div class="side">' + ''.join(
        f'<figure id="histogram-{index}"></figure>' for index in range(len(histograms)))
        + '</div><p class="faint">Bars: frames. Curve: what the sigma of each frame lets expect '
        'of normal errors.</p>')


def _sky(recording: Recording, sky: Any) -> str:
    if sky is None:
        return _missing('The bag holds no attitude: there is no path on the sky.')
    text = '<figure class="sky" id="sky"></figure><p class="faint">Path of the boresight; green: '
    text += 'stars that were used; grey: other stars. East is left. '
    text += ('Hammer projection of the whole sky.' if sky['wholeSky']
             else 'Stereographic projection.') + '</p>'
    if recording.camera is None:
        text += _missing('The bag holds no usable camera_info: the edge of the image is unknown.')
    return text


def _latency(panels: Panels, shown: Sequence[Panel]) -> str:
    rows = panels.latency_rows()
    if not rows:
        return _missing('The bag holds no two stages of a frame (images, centroids, tracks, '
                        'attitude): there is nothing to measure between.')
    return _plots(shown, '') + _table(
        ('stage', 'frames', 'p50 [ms]', 'p95 [ms]', 'longest [ms]'),
        [(name, str(count), *(f'{value:.2f}' for value in values))
         for name, count, *values in rows], numeric=range(1, 5)) + (
        '<p class="faint">From sending the message of one stage to sending that of the next, '
        'transport and waiting included.</p>')


def _frames(panels: Panels, pictures: Sequence[FramePicture], why_none: str) -> str:
    text = _missing(why_none) if why_none else ''
    if not pictures:
        return text or _missing('The images of the bag cannot be found again.')
    text += '<p><button id="marks" type="button" aria-pressed="true">marks</button></p>'
    return text + '<div class="side" id="frames">' + ''.join(
        _frame(panels, picture) for picture in pictures) + '</div>'


def _frame(panels: Panels, picture: FramePicture) -> str:
    marks = picture.marks
    size = max(picture.width, picture.height) / 100
    names = marks.dtype.names or ()
    hips = marks['hip'] if 'hip' in names else np.zeros(len(marks), int)
    named = set(np.argsort(-marks['flux'])[:_NAMED_STARS].tolist())
    parts = []
    for index, row in enumerate(marks):
        hip = int(hips[index])
        missed = 'missed' in names and row['missed'] > 0
        u, v = float(row['u']) + 0.5, float(row['v']) + 0.5
        kind = 'mark lost' if missed else 'mark known' if hip else 'mark'
        words = f'HIP {hip}, V {row["magnitude"]:.2f}' if hip else 'not identified'
        words += ', not seen in this frame' if missed else ''
        parts.append(f'<circle class="{kind}" cx="{u:.1f}" cy="{v:.1f}" r="{1.2 * size:.1f}" '
                     f'stroke-width="{0.3 * size:.2f}"><title>{words}</title></circle>')
        if hip and index in named:
            parts.append(f'<text class="mark-name" x="{u + 1.6 * size:.1f}" y="{v:.1f}" '
                         f'font-size="{3 * size:.1f}">{hip}</text>')
    time_s = (picture.stamp_ns - panels.start_ns) / 1e9
    known = int(np.count_nonzero(hips))
    what = f'{len(marks)} {picture.source}, {known} identified' if picture.source else (
        'the bag holds no stars of this frame')
    return (f'<figure><button class="frame" type="button" data-time="{time_s:.4f}" '
            f'aria-label="set the cursor to this frame"><img src="{picture.data_uri}" '
            f'width="{picture.width}" height="{picture.height}" alt="star field">'
            f'<svg viewBox="0 0 {picture.width} {picture.height}">{"".join(parts)}</svg></button>'
            f'<figcaption>{time_s:.2f} s: {escape(what)}</figcaption></figure>')


def _diagnostics(recording: Recording) -> str:
    table = diagnostics_table(recording)
    if not table:
        return _missing('The bag holds no diagnostics (/diagnostics).')
    return ''.join(_diagnostic(row) for row in table[:_LISTED]) + (
        _missing(f'{len(table) - _LISTED} more are left out.') if len(table) > _LISTED else '')


def _diagnostic(row: Any) -> str:
    counts = ' '.join(f'{_level_tag(level)} {count}' for level, count in sorted(
        row['levels'].items()))
    messages = sorted(row['messages'].items(), key=lambda item: item[1][0])
    body = _table(('first seen, UTC', 'times', 'message'), [
        (utc(stamp_ns), str(count), _level_tag(level) + ' ' + escape(message[:500]))
        for (level, message), (stamp_ns, count) in messages[:_LISTED]], numeric=(1,), marked=(2,))
    values = _table(('value, at the end', ''), [
        (key[:200], value[:500]) for key, value in row['values'][:_LISTED]])
    hardware = f' ({row["hardware_id"]})' if row['hardware_id'] else ''
    worst = max(row['levels'])
    was = f' was {_level_tag(worst)}' if worst > row['level'] else ''
    return (f'<details><summary>{_level_tag(row["level"])}{was} '
            f'<strong>{escape(row["name"][:200])}</strong>{escape(hardware[:200])}: '
            f'{escape(row["message"][:300])}</summary><p class="faint">{counts}</p>{body}{values}'
            '</details>')


def _level_tag(level: int) -> str:
    name, kind = _LEVELS.get(level, (f'LEVEL {level}', 'other'))
    return f'<span class="tag {kind}">{name}</span>'


def _topics(panels: Panels) -> str:
    rows = []
    for name, topic in sorted(panels.recording.topics.items()):
        rate = f'{topic.message_count / panels.duration_s:.2f}' if panels.duration_s else '-'
        rows.append((name[:300], topic.type_name[:300], str(topic.message_count), rate))
    if not rows:
        return _missing('The bag holds no topics.')
    return _table(('topic', 'type', 'messages', 'Hz'), rows, numeric=(2, 3))


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], *, numeric: Sequence[int] = (),
           marked: Sequence[int] = ()) -> str:
    """Return a table; cells are escaped, except in the columns that are marked up already."""
    def cell(tag: str, column: int, text: str) -> str:
        kind = ' class="number"' if column in numeric else ''
        safe = text if column in marked and tag == 'td' else escape(text)
        return f'<{tag}{kind}>{safe}</{tag}>'
    head = ''.join(cell('th', column, text) for column, text in enumerate(heads))
    body = ''.join('<tr>' + ''.join(cell('td', column, text)
                                    for column, text in enumerate(row)) + '</tr>' for row in rows)
    return (f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody>'
            '</table></div>')
