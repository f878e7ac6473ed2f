# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras out of FITS headers: astropy has the same angles between pixels."""

import warnings

from astropy.io import fits
from astropy.wcs import WCS
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.maths.rotation import quaternion_from_pointing
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.io.images.wcs_file import read_wcs_camera
from startracker_ros.photographs.sip import image_wcs, wcs_header

LENS = Camera(1024, 768, 1300.0, 1310.0, 530.0, 370.0, (-0.2, 0.05, 1e-3, -2e-3, 0.0))
Q = quaternion_from_pointing(*np.radians([296.7, 11.3, 335.0]))


def header(order=3, **terms):
    """Return the header of an image of 800 x 600 px, rows from the bottom, with SIP terms."""
    cards = fits.Header()
    values = {'SIMPLE': True, 'BITPIX': 8, 'NAXIS': 0, 'CTYPE1': 'RA---TAN-SIP',
              'CTYPE2': 'DEC--TAN-SIP', 'CRPIX1': 390.0, 'CRPIX2': 305.0, 'CRVAL1': 10.0,
              'CRVAL2': 60.0, 'CD1_1': -0.0171, 'CD1_2': 0.0102, 'CD2_1': 0.0102,
              'CD2_2': 0.0171, 'IMAGEW': 800, 'IMAGEH': 600, 'A_ORDER': order, 'B_ORDER': order}
    for key, value in (values | terms).items():
        cards[key] = value
    return cards


def radial(k):
    """Return the SIP terms of a radial distortion of the third power."""
    return {'A_3_0': k, 'A_1_2': k, 'B_0_3': k, 'B_2_1': k}


def sky(cards, pixels):
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        ra, dec = np.radians(WCS(cards).all_pix2world(pixels, 0)).T
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], -1)


def error_px(camera, cards, bottom_up):
    """Return the error of the angles between the pixels of a grid, times the focal length."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 7), np.linspace(0, camera.height - 1, 7))
    pixels = np.stack([u.ravel(), v.ravel()], -1)
    theirs = sky(cards, pixels)
    if bottom_up:
        pixels[:, 1] = camera.height - 1 - pixels[:, 1]
    ours = camera.unproject(pixels)
    # A rotation that the camera does not have; a mirrored image would have no such.
    left, _, right = np.linalg.svd(theirs.T @ ours)
    assert np.linalg.det(left @ right) > 0
    return np.abs(ours @ (left @ right).T - theirs).max() * camera.fx


@pytest.mark.parametrize('bottom_up', [False, True])
def test_an_exported_camera_comes_back(bottom_up, tmp_path):
    path = tmp_path / 'a.wcs'
    path.write_bytes(wcs_header(image_wcs(SkyMapping(LENS, Q), bottom_up=bottom_up)))
    found = read_wcs_camera(path)
    assert found.residual_px < 0.02
    assert found.bottom_up is bottom_up
    expected = [LENS.fx, LENS.fy, LENS.cx, LENS.cy]
    camera = found.camera
    np.testing.assert_allclose([camera.fx, camera.fy, camera.cx, camera.cy], expected, atol=0.2)
    np.testing.assert_allclose(camera.distortion[:2], LENS.distortion[:2], atol=2e-3)
    assert load_camera(path) == camera


def test_an_exported_fisheye_comes_back(tmp_path):
    path = tmp_path / 'a.wcs'
    lens = Camera(1024, 768, 300.0, 305.0, 516.0, 378.0, (-0.05, -0.01, 0.0, 0.0), 'equidistant')
    path.write_bytes(wcs_header(image_wcs(SkyMapping(lens, Q), bottom_up=True)))
    camera = load_camera(path)
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion],
        [lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion], rtol=1e-6, atol=1e-6)
    path.write_bytes(path.read_bytes().replace(b'PV2_1   =                  1.0',
                                               b'PV2_1   =                  2.0'))
    with pytest.raises(CameraError, match='PV2_m'):
        load_camera(path)


@pytest.mark.parametrize('cards', [
    header(), header(**radial(-3e-8)), header(A_2_0=1e-6, B_1_1=1e-6),
    header(CD1_1=0.0171, CD1_2=0.0102, CD2_1=-0.0102)],
    ids=['ideal', 'radial', 'any', 'rows down'])
def test_angles_are_those_of_astropy(cards, tmp_path):
    path = tmp_path / 'a.fits'
    path.write_bytes(cards.tostring().encode())
    found = read_wcs_camera(path)
    assert found.bottom_up is (cards['CD1_1'] < 0)
    assert error_px(found.camera, cards, found.bottom_up) < found.residual_px + 0.05


def test_header_as_text_and_behind_an_image(tmp_path):
    (tmp_path / 'a.hdr').write_text(header(**radial(-3e-8)).tostring(sep='\n', padding=False))
    camera = load_camera(tmp_path / 'a.hdr')
    assert camera.distortion[0] > 0.1
    cards = header(**radial(-3e-8))
    for key in ('SIMPLE', 'IMAGEW', 'IMAGEH'):
        del cards[key]
    image = fits.ImageHDU(np.zeros((600, 800), np.uint8), cards)
    fits.HDUList([fits.PrimaryHDU(np.zeros((70, 50), np.int16)), image]).writeto(
        tmp_path / 'a.fits')
    assert load_camera(tmp_path / 'a.fits') == camera


@pytest.mark.parametrize('cards, words', [
    (header(A_0_2=2e-4, B_2_0=-3e-4), 'leaves .* px, at most 0.5 px'),
    (header(CTYPE1='RA---ZPN'), 'RA---ZPN, DEC--TAN-SIP is not TAN'),
    (header(IMAGEW=None, CRPIX1='NaN'), 'no'),
    (fits.Header({'SIMPLE': True}), 'no FITS header with CTYPE1')])
def test_what_is_not_a_camera_is_named(cards, words, tmp_path):
    path = tmp_path / 'a.wcs'
    path.write_bytes(cards.tostring().encode())
    with pytest.raises(CameraError, match=words) as caught:
        load_camera(path)
    assert str(path) in str(caught.value)
