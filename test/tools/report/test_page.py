# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of a bag, as text and in headless Chromium."""

from html.parser import HTMLParser
import json
from pathlib import Path
import re
import shutil

from browser import Page
from click.testing import Result
from commands import invoke
import numpy as np
import pytest
from run_bag import write_run
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.tools.report.page import json_block, write_report
from startracker_ros.tools.report.panels import Panels

SECTIONS = ('state', 'attitude', 'error', 'histogram', 'sky-map', 'star-count', 'residual',
            'delay', 'frame', 'diagnostic', 'topic')


@pytest.fixture(scope='module')
def report(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('page') / 'report.html'
    write_report(run, path)
    return path


class Elements(HTMLParser):
    """Collects the elements of a page with their attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def test_page_fetches_nothing_and_runs_nothing_but_its_own(report: Path) -> None:
    elements = Elements(report.read_text())
    for tag, attributes in elements.found:
        assert not any(name.startswith('on') for name in attributes), tag
        assert tag not in ('link', 'iframe', 'object', 'embed', 'base', 'form')
        for name in ('src', 'href'):
            link = attributes.get(name) or '#'
            assert link.startswith(('#', 'data:image/png;base64,')), link
    assert [tag for tag, _ in elements.found].count('script') == 2
    assert any(attributes.get('name') == 'viewport' for _, attributes in elements.found)
    # There is no fusion in the bag.
    assert not any(attributes.get('id') == 'section-heads' for _, attributes in elements.found)
    policy, = [attributes['content'] for _, attributes in elements.found
               if attributes.get('http-equiv') == 'Content-Security-Policy']
    assert "default-src 'none'" in policy and 'unsafe' not in policy


def test_text_of_a_bag_stays_text(page: Page, report: Path) -> None:
    """The statuses of the run hold markup, in their names, messages, keys and values."""
    text = report.read_text()
    assert '<img src=x' not in text
    assert '&lt;img src=x' in text
    page.load(report)
    assert page.count('img[src=x]') == 0
    assert 'onerror="alert(1)"' in page.text('#section-diagnostic summary')
    assert page.problems == []


def test_data_cannot_end_its_script() -> None:
    block = json_block({'</script>': ['<!--', '\u2028', None, 1.5]})
    assert '<' not in block
    assert json.loads(block) == {'</script>': ['<!--', '\u2028', None, 1.5]}


@pytest.mark.parametrize('width, height, phone, dark', [
    (1200, 900, False, False), (390, 844, True, True), (320, 568, True, False)])
def test_page_renders_without_an_error(page: Page, report: Path, width: int, height: int,
                                       phone: bool, dark: bool) -> None:
    page.resize(width, height, phone=phone, dark=dark)
    page.load(report)
    assert page.problems == []
    # Nothing is wider than the screen, and text can be read without zooming.
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.evaluate("""Math.min(...[...document.querySelectorAll('p, td, dd, button, text')]
        .filter((element) => !element.closest('.frame'))
        .map((element) => parseFloat(getComputedStyle(element).fontSize)))""") >= 11
    background = page.evaluate('getComputedStyle(document.body).backgroundColor')
    assert (sum(map(int, re.findall(r'\d+', background))) < 150) == dark
    for name in SECTIONS:
        assert page.count(f'#section-{name} .missing') == 0, page.text(f'#section-{name}')
    # The protection level and 3 sigma; the keys of bands and of the dots in them differ.
    assert page.count('#error-x path.band') == page.count('#error-x .swatch.band') == 2
    assert page.count('#error-z path.dots') == page.count('#error-x .swatch.dots') == 1
    assert page.count('#states rect.state') == 6
    assert page.count('.mark-name') > 10
    assert page.evaluate("""[...document.querySelectorAll('.mark-name')].every((name) => {
        const [box, shown] = [name.getBBox(), name.ownerSVGElement.viewBox.baseVal];
        return box.x >= 0 && box.x + box.width <= shown.width && box.y >= 0;
    })""")
    assert page.count('#histogram-2 rect.bar') == 31
    assert page.count('#sky circle.used') > 10
    assert page.count('.frame circle.known') > 10
    assert page.evaluate("[...document.querySelectorAll('.frame img')].every((image) => "
                         'image.complete && image.naturalWidth > 0)')
    # Everything drawn lies within its figure.
    assert page.evaluate("""[...document.querySelectorAll('.plot svg, .side svg')].every((svg) => {
        const box = svg.getBoundingClientRect();
        return box.left >= 0 && box.right <= innerWidth + 0.5 && box.height > 40;
    })""")


@pytest.fixture()
def wide(page: Page, report: Path) -> Page:
    page.resize(1200, 900)
    page.load(report)
    return page


def test_a_run_with_few_attitudes_does_not_look_like_a_good_one(
        page: Page, report: Path, tmp_path: Path) -> None:
    dropouts = Path(__file__).parents[3] / 'bags' / 'dropouts'
    write_report(dropouts, tmp_path / 'bag.html')
    for path, low in ((report, 0), (tmp_path / 'bag.html', 1)):
        page.load(path)
        assert page.count('.figures .low') == low


def test_one_spike_does_not_flatten_the_latency(run: Path, monkeypatch: pytest.MonkeyPatch
                                                ) -> None:
    panels = Panels(load_recording(run))
    assert panels.latency()[0]['range'] is None
    spent = np.full(100, 20.0)
    spent[50] = 900.0
    monkeypatch.setattr(Recording, 'stage_ms', lambda *_: (panels.frame_ns[:1].repeat(100), spent))
    assert panels.latency()[0]['range'] == [0.0, 50.0]
    assert panels.latency_rows()[0][-1] == 900.0


def test_a_bag_that_is_called_bag_has_the_name_of_its_folder(run: Path, tmp_path: Path) -> None:
    (tmp_path / 'demo').mkdir()
    shutil.copytree(run, tmp_path / 'demo' / 'bag')
    write_report(tmp_path / 'demo' / 'bag', tmp_path / 'report.html')
    assert '<title>Star tracker: demo/bag</title>' in (tmp_path / 'report.html').read_text()


def test_one_cursor_links_all_figures(wide: Page, run: Path) -> None:
    # The plot goes from 56 px to 10 px before the right edge.
    place = wide.evaluate("""(() => {
        const width = document.querySelector('#error-x svg').getBoundingClientRect().width;
        return (56 + 0.5 * (width - 66)) / width;
    })()""")
    wide.mouse('mouseMoved', '#error-x svg', place)
    time_s = float(re.search(r'[\d.]+', wide.text('#cursor-time'))[0])
    duration_s = Panels(load_recording(run)).duration_s
    assert time_s == pytest.approx(duration_s / 2, abs=0.05)
    assert re.fullmatch(r'protection level ±12 arcsec · 3 sigma ±6 arcsec · error \S+ arcsec',
                        wide.text('#error-x .readout'))
    assert 'tracks' in wide.text('#stars .readout')
    assert wide.text('#states .readout') == 'TRACKING'
    assert wide.count('.cursor[visibility=visible]') == wide.count('.plot svg')
    assert 'boresight at 2.9' in wide.text('#sky .readout')
    assert wide.problems == []


def test_frames_keys_and_slider_move_the_cursor(wide: Page) -> None:
    wide.click('#frames figure:nth-child(2) .frame')
    caption = float(wide.text('#frames figure:nth-child(2) figcaption').split(' s:')[0])
    assert wide.text('#cursor-time') == f't = {caption:.2f} s'
    assert f'boresight at {caption:.2f} s' in wide.text('#sky .readout')
    wide.evaluate("document.querySelector('#residuals svg').focus()")
    for key, sign in (('ArrowRight', 1), ('ArrowLeft', -1)):
        before = float(re.search(r'[\d.]+', wide.text('#cursor-time'))[0])
        wide.call('Input.dispatchKeyEvent', type='keyDown', key=key)
        after = float(re.search(r'[\d.]+', wide.text('#cursor-time'))[0])
        assert sign * (after - before) > 0
    wide.evaluate("""(() => {
        const slider = document.getElementById('cursor');
        slider.value = 4;
        slider.dispatchEvent(new Event('input'));
    })()""")
    assert wide.text('#cursor-time') == 't = 4.00 s'
    assert wide.text('#states .readout') == 'TRACKING'
    assert wide.problems == []


def test_dragging_chooses_a_time_for_all_figures(wide: Page) -> None:
    def labels(figure: str) -> str:
        return wide.evaluate(f"[...document.querySelectorAll('#{figure} .axis text')]"
                             '.map((text) => text.textContent)'
                             ".filter((t) => t.endsWith('s')).join()")
    whole = labels('latency')
    wide.mouse('mousePressed', '#error-y svg', 0.3)
    wide.mouse('mouseMoved', '#error-y svg', 0.4)
    wide.mouse('mouseMoved', '#error-y svg', 0.5)
    assert wide.count('#error-y .chosen') == 1
    wide.mouse('mouseReleased', '#error-y svg', 0.5)
    assert wide.count('.chosen') == 0
    assert labels('latency') == labels('error-y') != whole
    assert float(wide.evaluate("document.getElementById('cursor').min")) > 1
    wide.click('#zoom-out')
    wide.click('#whole')
    assert labels('latency') == whole
    wide.click('#zoom-in')
    assert labels('latency') != whole
    wide.click('#whole')
    assert wide.problems == []


def test_curves_marks_and_colours_can_be_switched(wide: Page) -> None:
    assert wide.count('#stars path[data-series]') == 3
    wide.click('#stars button')
    assert wide.count('#stars path[data-series]') == 2
    assert wide.evaluate("document.querySelector('#stars button').ariaPressed") == 'false'
    wide.click('#stars button')
    assert wide.count('#stars path[data-series]') == 3
    shown = "getComputedStyle(document.querySelector('.frame svg')).display !== 'none'"
    assert wide.evaluate(shown)
    wide.click('#marks')
    assert not wide.evaluate(shown)
    colour = 'getComputedStyle(document.body).backgroundColor'
    light = wide.evaluate(colour)
    wide.click('#theme')
    assert wide.evaluate(colour) != light
    wide.click('#theme')
    assert wide.evaluate(colour) == light
    wide.mouse('mouseMoved', '#histogram-0 rect.bar:nth-of-type(16)', 0.5, 0.9)
    assert re.search(r'\d+ frames, [\d.]+ expected', wide.text('#histogram-0 .readout'))
    wide.mouse('mouseMoved', '#sky circle.used')
    assert re.match(r'HIP \d+, V [\d.]+, used in \d+ frames', wide.text('#sky .readout'))
    assert wide.problems == []


@pytest.mark.parametrize('left_out, words', [
    (('truth/attitude',), {
        'error': 'holds no truth (/truth/attitude): the error is not known. Drawn is what',
        'histogram': 'holds no truth'}),
    (('image_raw',), {'frame': 'holds no images (/image_raw)'}),
    (('attitude_cov', 'attitude_imu'), {'error': 'holds no covariance of the attitude'}),
    (('camera_info',), {'sky-map': 'holds no usable camera_info'}),
    (('image_raw', 'attitude', 'attitude_cov', 'attitude_imu', 'tracks', 'centroids',
      'tracker_state', '/diagnostics', 'camera_info', 'truth/attitude'), {}),
    (('attitude', 'attitude_cov', 'attitude_imu', 'tracks', 'centroids', 'tracker_state',
      '/diagnostics'), {
          'state': 'holds no states', 'attitude': 'holds no attitude: only the truth is drawn',
          'error': 'holds no attitude', 'histogram': 'No frame has both',
          'sky-map': 'holds no attitude',
          'star-count': 'holds no star lists', 'residual': 'holds no tracks',
          'delay': 'holds no two stages', 'diagnostic': 'holds no diagnostics'}),
])
def test_what_a_bag_does_not_hold_is_said_in_place(
        page: Page, tmp_path: Path, left_out: tuple[str, ...], words: dict[str, str]) -> None:
    bag = write_run(tmp_path / 'run', leave_out=left_out)
    write_report(bag, tmp_path / 'report.html')
    page.load(tmp_path / 'report.html')
    assert page.problems == []
    for name in SECTIONS if words else ():
        if name in words:
            assert words[name] in page.text(f'#section-{name}')
        else:
            assert page.count(f'#section-{name} .missing') == 0
    if not words:
        assert page.count('.missing') >= len(SECTIONS) - 1


def test_a_slew_over_the_sky_is_drawn_on_a_map_of_all_of_it(page: Page, tmp_path: Path) -> None:
    def turn(topic: str, message: object) -> object:
        if topic == 'attitude' and message.header.stamp.sec % 2:
            q = message.quaternion
            q.x, q.y, q.z, q.w = q.w, q.z, -q.y, -q.x
        return message
    bag = write_run(tmp_path / 'run', leave_out=('attitude_imu', 'attitude_cov'), change=turn)
    write_report(bag, tmp_path / 'report.html')
    page.load(tmp_path / 'report.html')
    assert page.problems == []
    assert 'Hammer' in page.text('#section-sky-map')
    width, height = page.evaluate("(() => { const box = document.querySelector('#sky svg')"
                                  '.getBoundingClientRect(); return [box.width, box.height]; })()')
    assert width == pytest.approx(2 * height)
    inside = page.evaluate("""[...document.querySelectorAll('#sky circle')].every((star) => {
        const [x, y] = [star.cx.baseVal.value, star.cy.baseVal.value];
        const svg = star.ownerSVGElement;
        const [a, b] = [svg.clientWidth / 2, svg.clientHeight / 2];
        return ((x - a) / a) ** 2 + ((y - b) / b) ** 2 < 1.001;
    })""")
    assert inside


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a message cut off, with other bytes, or with invalid numbers."""
    changed, kind = bytearray(data), rng.integers(0, 8)
    if kind == 0:
        return data[:rng.integers(0, len(data) + 1)]
    if kind == 1:
        place = rng.integers(0, max(1, len(data) - 8))
        changed[place:place + 8] = rng.bytes(8)
    elif kind == 2:
        place = 4 * rng.integers(1, max(2, len(data) // 8))
        wrong = rng.choice([np.nan, np.inf, 1e308, -1e300, 1e-320])
        changed[place:place + 8] = np.float64(wrong).tobytes()
    return bytes(changed)


@pytest.mark.filterwarnings('error:.*:RuntimeWarning')
@pytest.mark.parametrize('seed', range(8))
def test_damaged_messages_are_counted_and_the_rest_is_shown(page: Page, tmp_path: Path,
                                                            seed: int) -> None:
    rng = np.random.default_rng(seed)
    bag = write_run(tmp_path / 'run', damage=lambda data: damaged(data, rng))
    write_report(bag, tmp_path / 'report.html')
    page.load(tmp_path / 'report.html')
    assert page.problems == []
    assert 'messages not used' in page.text('header')
    assert page.count('#sky circle.used') > 10


def test_the_command(run: Path, tmp_path: Path) -> None:
    def call(*arguments: str) -> Result:
        return invoke('report', *arguments)
    done = call(str(run), '-o', str(tmp_path / 'report.html'), '--json')
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)['rows']
    rows = {row['case']: row['ours'] for row in found}
    assert rows['frames'] == '60' and rows['image to attitude, p50 / p95'] == '19.0 / 19.0 ms'
    numbers = {row['case']: (row['value'], row['unit'], row['p95']) for row in found}
    assert numbers['frames'] == (60, '', None)
    assert numbers['roll protection level, median'] == (pytest.approx(120), 'arcsec', None)
    assert numbers['errors beyond protection level'] == (0, 'frames', None)
    assert numbers['image to attitude, p50 / p95'] == (pytest.approx(19), 'ms', pytest.approx(19))
    assert (tmp_path / 'report.html').read_text().startswith('<!DOCTYPE html>')
    for arguments, words in (([str(tmp_path / 'none')], 'none: No such file or directory'),
                             ([str(run), '-o', str(tmp_path / 'a' / 'b')], 'No such file'),
                             ([__file__], 'not an MCAP file')):
        done = call(*arguments)
        assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
        assert words in done.stderr
