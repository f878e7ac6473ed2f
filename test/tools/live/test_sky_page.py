# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of startracker live in Chromium: figures and image on phone and laptop."""

import socket
from urllib.error import HTTPError
from urllib.request import urlopen

from browser import assert_readable, Page
import cv2
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import quaternion_from_pointing
from startracker_ros.core.stages.annotate import Labels
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.picture import annotated
from startracker_ros.ros.processes import HarnessError
from startracker_ros.tools.live.sky_page import (
    degrees_text, hours_text, SkyPage, state_texts, THIS_MACHINE)

FIGURES = {
    'state': 'TRACKING', 'ra_deg': 83.8221, 'dec_deg': -5.3911, 'roll_deg': 12.5,
    'ra_sigma_arcsec': 2.34, 'dec_sigma_arcsec': 0.0517, 'roll_sigma_arcsec': 1234.0,
    'constellation': 'Ori', 'rate_deg_s': 0.0041, 'stars': 23, 'fwhm_px': 2.118,
    'exposure_ms': 200.0, 'gain': 64.0, 'frames': 1234}
NOTHING = {**{name: float('nan') for name in FIGURES}, 'state': 'LOST', 'constellation': '',
           'stars': 0, 'frames': 0}
PHONE_PX, LAPTOP_PX = 390, 1280
YEAR = 2026.0


def test_the_texts_have_hours_degrees_and_sigma():
    assert state_texts(FIGURES, '', 'device /dev/video0', 0.34) == {
        'state': 'TRACKING',
        'right ascension': '05h35m17.30s\n83.8221 deg\nsigma 2.3 arcsec',
        'declination': '-05d23\'28.0"\n-5.3911 deg\nsigma 0.052 arcsec',
        'roll': '12.5000 deg\nsigma 1200 arcsec', 'constellation': 'Orion',
        'rate': '0.0041 deg/s', 'stars tracked': '23',
        'focus': '2.12 px\nFWHM of the stars', 'exposure': '200 ms\ngain 64',
        'camera': 'device /dev/video0\n1234 frames\nnewest 0.3 s ago'}
    unknown = state_texts(NOTHING, 'too few stars', '', float('nan'))
    assert unknown['state'] == 'LOST\ntoo few stars' and unknown['stars tracked'] == '0'
    assert {unknown[name] for name in ('right ascension', 'declination', 'roll', 'constellation',
                                       'rate', 'focus', 'exposure')} == {'-'}
    assert unknown['camera'] == '0 frames'
    assert state_texts({**FIGURES, 'gain': float('nan')}, '', '', 1.0)['exposure'] == '200 ms'


@pytest.mark.parametrize('ra_deg, text', [
    (0.0, '00h00m00.00s'), (359.99999, '00h00m00.00s'), (14.999999, '01h00m00.00s'),
    (101.287155, '06h45m08.92s')])
def test_hours_carry(ra_deg, text):
    assert hours_text(ra_deg) == text


@pytest.mark.parametrize('dec_deg, text', [
    (-0.5, '-00d30\'00.0"'), (59.999999, '+60d00\'00.0"'), (-90.0, '-90d00\'00.0"'),
    (-16.716116, '-16d42\'58.0"')])
def test_degrees_keep_their_sign_and_carry(dec_deg, text):
    assert degrees_text(dec_deg) == text


def orion(share: float) -> np.ndarray:
    """Return an annotated image of 2048 x 1536 px with the brightest stars around Orion."""
    camera = Camera.from_fov(2048, 1536, 24.0)
    sky = SkyMapping(camera, quaternion_from_pointing(*np.radians([83.8, -1.0, 5.0])))
    stars = load_catalog().brighter_than(5.5)
    uv = sky.pixels(stars.directions(YEAR))
    seen = np.flatnonzero(camera.contains(uv))[:40]
    image = np.random.default_rng(1).normal(30, 4, (1536, 2048)).clip(0).astype(np.uint8)
    for (u, v), magnitude in zip(uv[seen], stars.magnitude[seen]):
        cv2.circle(image, (round(u), round(v)), round(7 - magnitude), 255, -1, cv2.LINE_AA)
    return annotated(image, uv[seen], stars.hip[seen], sky, YEAR, share=share)


@pytest.fixture
def served():
    with SkyPage(THIS_MACHINE, 0) as sky_page:
        sky_page.state = state_texts(FIGURES, '', 'device /dev/video0', 0.1)
        yield sky_page


def draw(sky_page: SkyPage) -> None:
    """Make the pictures that are wanted, as LiveView does."""
    for name, share in sky_page.wanted().items():
        sky_page.pictures[name] = cv2.imencode('.jpg', orion(share)[..., ::-1])[1].tobytes()


def test_the_page_is_readable_on_phone_and_laptop(page: Page, served, tmp_path):
    draw(served)
    assert_readable(page, served.url, 'first')
    # The phone has asked for its picture by now.
    draw(served)
    assert len(served.pictures) == 2
    for width_px, height_px, phone in ((PHONE_PX, 844, True), (LAPTOP_PX, 800, False)):
        page.resize(width_px, height_px, phone=phone, dark=True)
        page.load(served.url)
        page.evaluate('first')
        box = page.evaluate("""(({left, width, top}) => [left, width, top])(
            document.getElementById('sky').getBoundingClientRect())""")
        assert box[:2] == [0, width_px]
        # No line is broken, and nothing is cut off.
        assert page.evaluate("""[...document.querySelectorAll('dd')].every((dd) =>
            dd.scrollWidth <= dd.clientWidth && dd.clientHeight < 35)""")
        shown = page.evaluate("""Object.fromEntries([...document.querySelectorAll('#state div')]
            .map((card) => [...card.children].map((child) => child.textContent))
            .map(([name, ...lines]) => [name, lines.join('\\n')]))""")
        assert shown == served.state


def test_the_page_says_when_nothing_answers(page: Page, served):
    served.state = state_texts(
        NOTHING, 'too few stars', 'device /dev/video0: no image for 3 s', 3.0)
    page.resize(PHONE_PX, 844, phone=True)
    page.load(served.url)
    page.evaluate('first')
    # Before the first image there is no picture, and no place for it.
    assert page.evaluate("document.getElementById('sky').hidden")
    assert 'too few stars' in page.text('#state .bad')
    page.call('Network.emulateNetworkConditions', offline=True, latency=0, downloadThroughput=-1,
              uploadThroughput=-1)
    page.evaluate('refresh()')
    assert 'no answer' in page.text('#state') and 'LOST' not in page.text('#state')
    page.call('Network.emulateNetworkConditions', offline=False, latency=0,
              downloadThroughput=-1, uploadThroughput=-1)
    page.evaluate('refresh()')
    assert 'LOST' in page.text('#state') and not page.count('.ended')


@pytest.mark.parametrize('asked, screen_px, width_px, most_px', [
    ('sky_small.jpg', PHONE_PX, 2048, 16), ('sky_small.jpg', PHONE_PX, 640, 16),
    ('sky.jpg', LAPTOP_PX, 2048, 16), ('sky.jpg', LAPTOP_PX, 640, 30)])
def test_names_in_the_picture_are_legible(served, asked, screen_px, width_px, most_px):
    served.content(asked)
    black, sirius = np.zeros((3 * width_px // 4, width_px), np.uint8), np.array([[200.0, 200.0]])
    share = served.wanted()[asked]
    picture = annotated(black, sirius, np.array([32349]), None, YEAR, share=share).max(axis=2)
    picture[:, :200 + round(10.5 * Labels(black.shape, sirius, share).size)] = 0
    rows = np.flatnonzero(picture.max(axis=1) > 100)
    # A capital of 9 px is that of a text of 13 px.
    assert 9 <= np.ptp(rows) * screen_px / width_px <= most_px


def test_the_small_picture_is_made_for_who_asks(served):
    assert [*served.wanted()] == ['sky.jpg']
    served.pictures['sky.jpg'] = b'large'
    assert served.content('sky_small.jpg') == ('image/jpeg', b'large')
    assert [*served.wanted()] == ['sky.jpg', 'sky_small.jpg']


def test_nothing_else_is_served_and_a_taken_port_is_named(served):
    with pytest.raises(HTTPError, match='404'):
        urlopen(served.url + '../../etc/passwd', timeout=60)
    port = int(served.url.rstrip('/').rpartition(':')[2])
    with pytest.raises(HarnessError, match=f'127.0.0.1 port {port}: .*; choose another'):
        SkyPage(THIS_MACHINE, port)
    with SkyPage('0.0.0.0', 0) as everywhere:
        assert everywhere.url.startswith(f'http://{socket.gethostname()}:')
