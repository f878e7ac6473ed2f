# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real photographs from the files on: all that can be solved, nothing wrong."""

import csv
import warnings

from astropy.io import fits
from astropy.wcs import WCS
import cv2
import numpy as np
from PIL import Image
import pytest
import startracker_ros as st
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, quaternion_from_pointing, rotate, unit_from_radec)
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.io.images.images import ImageError, read_image
from startracker_ros.photographs.epoch_and_site import ObserverSite
from startracker_ros.photographs.solve import Outputs, solve_files

# A mirrored image is searched as it is until the time is over.
HASTY = IdentificationOptions(time_limit_s=0.2)


def known_rows(folder):
    with open(folder / 'solutions.csv') as file:
        return list(csv.DictReader(file))


def quaternion_of(row):
    return quaternion_from_pointing(*np.radians(
        [row['ra_deg'], row['dec_deg'], row['roll_deg']]))


def test_night_sky_of_11_degrees(sky_data, tmp_path):
    folder = sky_data / 'night-sky-11deg'
    known = known_rows(folder)
    result = solve_files([folder / row['file'] for row in known], fov_deg=11.4,
                         epoch_year=2019.57, outputs=Outputs(tmp_path, tmp_path))
    for row, truth in zip(result.rows, known):
        assert row['solved'], (row['file'], row['reason'])
        q = np.array([float(truth[name]) for name in ('qx', 'qy', 'qz', 'qw')])
        error = attitude_error(quaternion_of(row), q / np.linalg.norm(q)) / ARCSEC
        assert np.hypot(error[0], error[1]) < 30
        assert abs(error[2]) < 100
        assert row['fov_deg'] == pytest.approx(float(truth['hfov_deg']), abs=0.02)
        assert row['residual_arcsec'] < 12
        # The known answers are the places of the catalogue, as the header has them.
        with warnings.catch_warnings(action='ignore'):
            header = WCS(fits.getheader((tmp_path / row['file']).with_suffix('.wcs')))
        seen = unit_from_radec(*np.radians(header.all_pix2world(511.5, 383.5, 0)))
        assert np.linalg.norm(seen - rotate(q, [0.0, 0.0, 1.0])) < 12 * ARCSEC
    assert len(list(tmp_path.glob('*.png'))) == len(list(tmp_path.glob('*.wcs'))) == len(known)


@pytest.mark.slow
def test_hard_night_sky_of_6_degrees(sky_data):
    """
    The images that nobody solved have no known answer, but one camera took them all.

    Its focal length is free by half a percent: a wrong answer would put it anywhere there.
    """
    folder = sky_data / 'night-sky-6deg'
    known = known_rows(folder)
    result = solve_files([folder / row['file'] for row in known], fov_deg=6.07,
                         epoch_year=2019.0)
    for row, truth in zip(result.rows, known):
        if truth['grade'] in 'AB':
            assert row['solved'], (row['file'], row['reason'])
        if not row['solved']:
            continue
        assert row['fov_deg'] == pytest.approx(6.0745, abs=0.004), row['file']
        if truth['ra_deg']:
            q = quaternion_from_pointing(*np.radians(
                [float(truth['ra_deg']), float(truth['dec_deg']), row['roll_deg']]))
            error = attitude_error(quaternion_of(row), q) / ARCSEC
            assert np.hypot(error[0], error[1]) < 60, row['file']


def test_mirror_flips_images_first(sky_data, tmp_path):
    folder = sky_data / 'night-sky-11deg'
    name = known_rows(folder)[0]['file']
    cv2.imwrite(str(tmp_path / name), read_image(folder / name)[:, ::-1])
    flipped = solve_files([tmp_path / name], fov_deg=11.4, epoch_year=2019.57, mirror=True)
    straight = solve_files([folder / name], fov_deg=11.4, epoch_year=2019.57)
    assert flipped.rows[0]['quaternion'] == straight.rows[0]['quaternion']
    assert not flipped.rows[0]['mirrored']
    assert flipped.conditions['mirror'] and 'mirror' not in straight.conditions


@pytest.mark.slow
def test_a_fits_image_without_row_order_is_solved_by_both(sky_data, tmp_path):
    name = known_rows(sky_data / 'night-sky-11deg')[0]['file']
    image = read_image(sky_data / 'night-sky-11deg' / name)
    fits.PrimaryHDU(image).writeto(tmp_path / 'unknown.fits')
    fits.PrimaryHDU(image, fits.Header([('ROWORDER', 'BOTTOM-UP')])).writeto(
        tmp_path / 'known.fits')
    result = solve_files([tmp_path / 'unknown.fits', tmp_path / 'known.fits'], fov_deg=11.4,
                         epoch_year=2019.57, options=HASTY)
    unknown, known = result.rows
    straight, = solve_files([sky_data / 'night-sky-11deg' / name], fov_deg=11.4,
                            epoch_year=2019.57).rows
    assert unknown['quaternion'] == straight['quaternion'] and not unknown['mirrored']
    # Its rows are stated to be in the other order: that image is mirrored.
    assert known['solved'] and known['mirrored']
    assert abs(known['ra_deg'] - straight['ra_deg']) < 0.003
    assert 'unknown.fits' in result.conditions['first row at the top']
    solution = st.solve(tmp_path / 'unknown.fits', fov_deg=11.4, epoch=2019.57,
                        time_limit_s=HASTY.time_limit_s)
    assert solution.turned_over and solution.matched == straight['matched']
    assert not st.solve(image, fov_deg=11.4, epoch=2019.57).turned_over


def test_a_calibrated_camera_must_fit_the_image(sky_data, tmp_path):
    save_camera(Camera.from_fov(640, 480, 11.4), tmp_path / 'camera.yaml')
    image = sky_data / 'night-sky-11deg' / known_rows(sky_data / 'night-sky-11deg')[0]['file']
    row, = solve_files([image], camera_file=tmp_path / 'camera.yaml').rows
    assert not row['solved']
    assert '1024 x 768 px, the camera has 640 x 480' in row['reason']
    with pytest.raises(CameraError):
        solve_files([image], fov_deg=400.0)


@pytest.fixture
def taken_with_zone(sky_data, tmp_path):
    """Return one image with the time of its EXIF, with and without the time zone."""
    folder = sky_data / 'night-sky-11deg'
    with Image.open(folder / known_rows(folder)[2]['file']) as picture:
        for name, details in (('zone.png', {0x9011: '+02:00'}), ('none.png', {})):
            exif = Image.Exif()
            exif[0x0112] = 1
            exif[0x8769] = {0x9003: '2019:07:29 22:47:26', **details}
            picture.save(tmp_path / name, exif=exif)
    return tmp_path / 'zone.png', tmp_path / 'none.png'


@pytest.mark.slow
def test_the_epoch_is_that_of_exif_unless_there_is_an_option(taken_with_zone):
    zone, none = taken_with_zone
    result = solve_files([zone, none], fov_deg=11.4)
    first, second = result.rows
    assert (first['epoch_from'], second['epoch_from']) == ('EXIF', 'EXIF, UTC assumed')
    assert first['epoch'] == pytest.approx(2019.573, abs=1e-3)
    assert second['epoch'] - first['epoch'] == pytest.approx(2 / 24 / 365.25, rel=1e-5)
    assert result.conditions['epoch'] == first['epoch']
    assert result.conditions['epoch_from'] == 'EXIF; EXIF, UTC assumed'
    assert result.conditions['aberration'] == 'earth_only'
    given = solve_files([zone], fov_deg=11.4, epoch_year=2021.0)
    assert (given.conditions['epoch'], given.conditions['epoch_from']) == (2021.0, 'option')
    # Half a year of the motion of the Earth: 40 arcsec at most.
    turn = attitude_error(quaternion_of(given.rows[0]), quaternion_of(first)) / ARCSEC
    assert 5 < np.hypot(*turn[:2]) < 41


@pytest.mark.slow
def test_refraction_needs_the_hour(taken_with_zone):
    site = ObserverSite(site=Site(52.2, 4.4, 0.0))
    zone, none = solve_files(taken_with_zone, fov_deg=11.4, observer_site=site).conditions[
        'aberration'].split('; ')
    assert zone == 'full' and none.startswith('earth_only (no time zone in EXIF')


@pytest.mark.parametrize('mirror', [False, True])
def test_a_fits_image_and_the_header_of_its_pixels(sky_data, tmp_path, mirror):
    """Altair is the brightest spot of the file, wherever rows and columns begin."""
    folder = sky_data / 'night-sky-11deg'
    rows = read_image(folder / known_rows(folder)[2]['file'])[::-1]
    pixels = (rows[:, ::-1] if mirror else rows) / np.float32(4096)
    fits.PrimaryHDU(pixels, fits.Header([('DATE-OBS', '2019-07-29T20:47:26')])).writeto(
        tmp_path / 'a.fits')
    result = solve_files([tmp_path / 'a.fits'], fov_deg=11.4, mirror=mirror,
                         outputs=Outputs(wcs_folder=tmp_path))
    assert result.rows[0]['solved'], result.rows[0]['reason']
    assert result.rows[0]['epoch_from'] == 'DATE-OBS'
    v, u = np.unravel_index(cv2.GaussianBlur(pixels, (0, 0), 3).argmax(), pixels.shape)
    with warnings.catch_warnings(action='ignore'):
        header = WCS(fits.getheader(tmp_path / 'a.wcs'))
    seen = unit_from_radec(*np.radians(header.all_pix2world(u, v, 0)))
    altair = unit_from_radec(*np.radians([297.6958, 8.8683]))
    # A pixel is 40 arcsec.
    assert np.linalg.norm(seen - altair) < 60 * ARCSEC


def test_without_a_time_the_epoch_is_today(sky_data):
    folder = sky_data / 'night-sky-11deg'
    result = solve_files([folder / known_rows(folder)[2]['file']], fov_deg=11.4)
    assert result.rows[0]['epoch_from'] == result.conditions['epoch_from'] == 'today'
    assert result.conditions['aberration'] == 'none (no --epoch)'


@pytest.mark.parametrize('content', [b'', b'GIF89a not quite', b'\x89PNG\r\n\x1a\n'])
def test_files_that_hold_no_image(tmp_path, content):
    path = tmp_path / 'image.png'
    path.write_bytes(content)
    with pytest.raises(ImageError, match='image.png: not an image'):
        read_image(path)
    with pytest.raises(ImageError, match='No such file'):
        read_image(tmp_path / 'absent.png')


def test_colours_become_grey_and_depth_is_kept(tmp_path):
    colour = np.zeros((4, 5, 3), np.uint16)
    colour[..., 0], colour[..., 1], colour[..., 2] = 300, 600, 900
    cv2.imwrite(str(tmp_path / 'colour.png'), colour)
    image = read_image(tmp_path / 'colour.png')
    assert image.dtype == np.uint16 and image.shape == (4, 5)
    assert (image == 600).all()


def test_each_selected_frame_of_a_video_is_a_row(sky_data, tmp_path):
    folder = sky_data / 'night-sky-11deg'
    known = known_rows(folder)[1:3]
    # Of 8 bit: Pillow before 10.3 takes animated PNG of 16 bit with the same white for one page.
    pages = [Image.fromarray(np.uint8(np.minimum(read_image(folder / row['file']) // 128, 255)))
             for row in known]
    (tmp_path / 'video').mkdir()
    # The second file has the same stem: its pictures have names of their own.
    for path in (tmp_path / 'a.tif', tmp_path / 'video' / 'a.png'):
        pages[0].save(path, save_all=True, append_images=[pages[1], pages[0]])
    paths = [tmp_path / 'a.tif', tmp_path / 'video' / 'a.png', folder / known[0]['file']]
    result = solve_files(paths, fov_deg=11.4, epoch_year=2019.57, selection=slice(0, 2),
                         outputs=Outputs(tmp_path / 'pictures'))
    assert [(row['file'], row['frame']) for row in result.rows] == [
        ('a.tif#0', 0), ('a.tif#1', 1), ('a.png#0', 0), ('a.png#1', 1), (known[0]['file'], None)]
    assert result.rows[1]['path'] == str(paths[0])
    for row, truth in zip(result.rows, [*known, *known, known[0]]):
        seen, true = (unit_from_radec(*np.radians([float(each['ra_deg']), float(each['dec_deg'])]))
                      for each in (row, truth))
        assert np.linalg.norm(seen - true) < 60 * ARCSEC
    names = {path.stem for path in (tmp_path / 'pictures').iterdir()}
    assert len(names) == 5 and 'a_frame00001' in names and 'a-2_frame00001' in names
    nothing, = solve_files(paths[:1], fov_deg=11.4, selection=slice(7, None)).rows
    assert not nothing['solved'] and 'no frame' in nothing['reason']
