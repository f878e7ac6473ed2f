# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""FITS headers of solved images, read by astropy: pixel to sky and back, as our camera has it."""

import warnings

from astropy.io import fits
from astropy.wcs import WCS
import numpy as np
import pytest
from startracker_ros.core.astro.aberration import state_near_earth
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import quaternion_from_pointing, unit_from_radec
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.sip import fit_sip, image_wcs, wcs_header, WcsError

YEAR = 2026.4
ORBIT = state_near_earth(YEAR, np.array([0.0, 6499.0, 3752.0]))
SITE = Site(48.0, 11.5, 500.0)


def ground():
    """Return the state of a camera on the ground that looks 40 deg high."""
    return state_near_earth(YEAR, SITE.velocity_m_s(YEAR))._replace(air=SITE.air(YEAR))


def camera(fov_deg, distortion=(), centre=(0.0, 0.0), ratio=1.0):
    ideal = Camera.from_fov(1024, 768, fov_deg)
    return Camera(1024, 768, ideal.fx, ideal.fx * ratio, ideal.cx + centre[0],
                  ideal.cy + centre[1], (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5])


def astropy_wcs(cards) -> WCS:
    content = wcs_header(cards)
    assert len(content) % 2880 == 0
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        # As for every .wcs file: the header has axes, the file no pixels.
        warnings.filterwarnings('ignore', 'The WCS transformation has more axes')
        return WCS(fits.Header.fromstring(content.decode('ascii')))


CASES = [
    (camera(11.4), (296.7, 11.3, 335.0), None),
    (camera(11.4, (0.12,), (8, -12)), (296.7, 11.3, 335.0), ORBIT),
    (camera(3.0), (10.0, 89.99, 20.0), ORBIT),
    (camera(25.0, (-0.2, 0.05, 1e-3, -2e-3, 0.0), (40, 20), 1.05), (0.01, -45.0, 100.0), ORBIT),
    (camera(50.0, (-0.1, 0.01)), (120.0, -80.0, 7.0), None),
    (camera(50.0, (-0.25,), (30, 10)), (120.0, 60.0, 200.0), ORBIT),
    (camera(20.0, (), (-900.0, 500.0)), (80.0, 0.0, 0.0), None),
    (camera(20.0, (0.05,)), None, ground())]


@pytest.mark.parametrize('lens, pointing_deg, state', CASES)
def test_astropy_has_the_pixels_of_the_camera(lens, pointing_deg, state):
    if pointing_deg is None:
        zenith = state.air.zenith
        ra, dec = np.arctan2(zenith[1], zenith[0]), np.arcsin(zenith[2]) - np.radians(50)
        q = quaternion_from_pointing(ra, dec, 0.3)
    else:
        q = quaternion_from_pointing(*np.radians(pointing_deg))
    sky = SkyMapping(lens, q, state)
    wcs = astropy_wcs(image_wcs(sky))
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.5, 1023.5, 37),
                                                 np.linspace(-0.5, 767.5, 23)))
    # The first pixel of FITS is (1, 1), ours is (0, 0).
    ra, dec = np.radians(wcs.all_pix2world(u + 1, v + 1, 1))
    back = sky.pixels(unit_from_radec(ra, dec))
    assert np.abs(back - np.stack([u, v], -1)).max() < 0.05
    # The inverse polynomials, which astropy applies to the undistorted pixels.
    focal = wcs.sip_foc2pix(*wcs.wcs.s2p(np.degrees(np.stack([ra, dec], -1)), 1)['pixcrd'].T
                            - wcs.wcs.crpix[:, None], 1)
    again = np.stack(focal, -1) - 1
    assert np.abs(again - np.stack([u, v], -1)).max() < 0.05


@pytest.mark.parametrize('state, kind', [(None, 'ZPN'), (ORBIT, 'ZPN-SIP'),
                                           (ground(), 'ZPN-SIP')])
@pytest.mark.parametrize('turned', [False, True])
def test_a_fisheye_is_in_a_projection_that_has_its_horizon(state, kind, turned):
    """No tangent plane has it; the corners of this image are outside of its circle."""
    lens = Camera(1024, 768, 300.0, 305.0, 516.0, 378.0, (-0.05, -0.01, 0.0, 0.0), 'equidistant')
    zenith = (unit_from_radec(0.8, 0.7) if state is None or state.air is None else
              state.air.zenith)
    ra, dec = np.arctan2(zenith[1], zenith[0]), np.arcsin(zenith[2]) - 0.3
    q = quaternion_from_pointing(ra, dec, 0.2)
    sky = SkyMapping(lens, q, state)
    pixels = np.stack(np.meshgrid(
        np.linspace(0, 1023, 31), np.linspace(0, 767, 23)), -1).reshape(-1, 2)
    with np.errstate(invalid='ignore'):
        direction = sky.directions(pixels)
    # Above the horizon, where there are stars.
    seen = direction @ zenith > 0.05
    assert np.isnan(direction).any() and seen.mean() > 0.3
    wcs = astropy_wcs(image_wcs(sky, turned, turned, pixels[seen]))
    assert wcs.wcs.ctype[0] == f'RA---{kind}'
    there = np.where(turned, [1023, 767] - pixels[seen], pixels[seen])
    theirs = unit_from_radec(*np.radians(wcs.all_pix2world(there, 0)).T)
    assert np.abs(sky.pixels(theirs) - pixels[seen]).max() < 0.5


def test_a_header_that_has_the_stars_elsewhere_is_not_written():
    lens = Camera(1000, 1000, 460.0, 460.0, 499.5, 499.5, (0, 0, 0, 0, 0, 0.1, 0, 0),
                  'rational_polynomial')
    sky = SkyMapping(lens, quaternion_from_pointing(1.0, 0.5, 0.3))
    # In the middle it is right.
    assert image_wcs(sky, stars_px=np.array([[500.0, 480.0], [300.0, 400.0]]))
    with pytest.raises(WcsError, match='stars .* px off'):
        image_wcs(sky, stars_px=np.stack(np.meshgrid(
            np.linspace(0, 999, 15), np.linspace(0, 999, 15)), -1).reshape(-1, 2))


def test_pixels_count_from_one():
    """One pixel off would be 40 arcsec here."""
    sky = SkyMapping(camera(11.4), quaternion_from_pointing(1.0, 0.5, 0.2))
    wcs = astropy_wcs(image_wcs(sky))
    centre = np.radians(wcs.all_pix2world(512.5, 384.5, 1))
    np.testing.assert_allclose(centre, (1.0, 0.5), atol=1e-12)
    np.testing.assert_allclose(wcs.all_pix2world(0, 0, 0), wcs.all_pix2world(1, 1, 1))
    first = np.degrees(np.arctan2(*sky.directions(np.zeros((1, 2)))[0, 1::-1]))
    assert wcs.all_pix2world(1, 1, 1)[0] == pytest.approx(first, abs=1e-6)


def test_the_order_is_the_lowest_that_is_enough():
    def order(lens):
        sky = SkyMapping(lens, quaternion_from_pointing(1.0, 0.5, 0.2))
        sip = fit_sip(sky.directions, lens.width, lens.height, np.array([lens.cx, lens.cy]))
        assert max(sip.error_px, sip.inverse_error_px) < 0.02
        return sip.order

    assert order(camera(11.4)) == 2
    assert order(camera(11.4, (0.1,))) in (3, 4)
    assert order(camera(50.0, (-0.2,))) > 4


def test_cards_are_of_fixed_format():
    content = wcs_header(image_wcs(SkyMapping(camera(50.0, (-0.1,)),
                                              quaternion_from_pointing(1, 0, 0))))
    cards = [content[at:at + 80].decode() for at in range(0, len(content), 80)]
    assert cards[0] == f'SIMPLE  = {"T":>20}'.ljust(80)
    assert cards.count('END'.ljust(80)) == 1
    assert all(card[8:10] == '= ' for card in cards[:cards.index('END'.ljust(80)) - 1])
    header = fits.Header.fromstring(content.decode())
    for card in header.cards:
        card.verify('exception')


@pytest.mark.parametrize('mirrored', [False, True])
@pytest.mark.parametrize('bottom_up', [False, True])
def test_headers_count_rows_and_columns_as_the_file_does(mirrored, bottom_up):
    sky = SkyMapping(camera(11.4, (0.1,), (5, 9)), quaternion_from_pointing(1.0, 0.5, 0.2))
    upright, turned = astropy_wcs(image_wcs(sky)), astropy_wcs(image_wcs(sky, mirrored, bottom_up))
    for u, v in ((0, 0), (1000, 20), (300, 700)):
        there = 1023 - u if mirrored else u, 767 - v if bottom_up else v
        np.testing.assert_allclose(turned.all_pix2world(*there, 0),
                                   upright.all_pix2world(u, v, 0), atol=2e-6)
    # One flip changes the handedness.
    assert (np.linalg.det(turned.wcs.cd) > 0) == (mirrored == bottom_up)
