# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`startracker calibrate` on real photographs, and its refusals."""

import csv
import json

from commands import invoke
import cv2
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, quaternion_from_pointing
from startracker_ros.io.images.camera_files import load_camera, save_camera
from startracker_ros.io.images.images import read_image
from startracker_ros.photographs.solve import solve_files


def calibrate(*arguments):
    return invoke('calibrate', *map(str, arguments))


@pytest.fixture(scope='module')
def night_sky(sky_data):
    folder = sky_data / 'night-sky-11deg'
    with open(folder / 'solutions.csv') as file:
        known = list(csv.DictReader(file))
    return [folder / row['file'] for row in known], known


@pytest.fixture(scope='module')
def calibrated(night_sky, tmp_path_factory):
    output = tmp_path_factory.mktemp('calibrated') / 'camera.yaml'
    done = calibrate(*night_sky[0], '-o', output, '--fov-deg', 11.4, '--epoch', 2019.57, '--json')
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout), output


def test_the_lens_part_of_the_residual_goes_and_it_is_not_an_over_fit(calibrated):
    """Errors of the centroids, in all residuals alike, average out over the cells of the image."""
    document, _ = calibrated
    figures = document['conditions']
    assert figures['images'] == 8 and figures['stars'] > 700
    assert figures['covered_percent'] == 100
    assert figures['pinhole_lens_arcsec'] > 4
    assert figures['calibrated_lens_arcsec'] < figures['pinhole_lens_arcsec'] / 2
    assert figures['left_out_lens_arcsec'] < figures['pinhole_lens_arcsec'] / 2
    assert figures['left_out_arcsec'] < 1.02 * figures['calibrated_arcsec']
    for row in document['rows']:
        assert row['used'] and row['stars'] > 40
        assert row['left_out_arcsec'] < 0.9 * row['pinhole_arcsec'], row


def test_parameters_come_with_their_errors(calibrated):
    document, output = calibrated
    figures = document['conditions']
    camera = load_camera(output)
    assert camera.fx == camera.fy == figures['focal']
    assert camera.fx == pytest.approx(5113.8, abs=1.5) and 0 < figures['focal_sigma'] < 0.5
    # A 35 mm lens on pixels of 6.9 um, whose axis is near the middle of the sensor.
    assert np.hypot(camera.cx - 511.5, camera.cy - 383.5) < 20
    assert 0.05 < camera.distortion[0] < 0.2
    for name in ('k1', 'cx', 'cy'):
        assert 0 < figures[f'{name}_sigma'] < 1


def test_magnitudes_are_predicted_in_the_band_of_the_camera(calibrated):
    figures = calibrated[0]['conditions']
    assert 0.4 < figures['colour_term'] < 0.7 and figures['colour_term_sigma'] < 0.05
    assert 0.3 < figures['corner_mag'] < 0.7
    assert figures['scatter_mag'] <= 0.2
    for band in ('v', 'hp', 'g'):
        assert figures[f'scatter_{band}_mag'] > 1.3 * figures['scatter_mag']


def test_the_calibrated_camera_solves_the_same_sky(calibrated, night_sky):
    paths, known = night_sky
    result = solve_files(paths, camera_file=calibrated[1], epoch_year=2019.57)
    for row, truth in zip(result.rows, known):
        assert row['solved'], row['reason']
        # The centre of the image, as the known answers have it, is not the boresight.
        camera = load_camera(calibrated[1])
        axis = camera.unproject(np.array([511.5, 383.5]))
        q = quaternion_from_pointing(*np.radians(
            [row['ra_deg'], row['dec_deg'], row['roll_deg']]))
        known_q = np.array([float(truth[name]) for name in ('qx', 'qy', 'qz', 'qw')])
        error = attitude_error(q, known_q / np.linalg.norm(known_q)) / ARCSEC
        offset = np.array([-axis[1], axis[0]]) / ARCSEC
        assert np.hypot(*(error[:2] + offset)) < 30, (row['file'], error, offset)


@pytest.mark.long
def test_images_that_cannot_be_used_are_named(night_sky, tmp_path):
    paths = night_sky[0][2:6]
    (tmp_path / 'notes.png').write_text('not an image')
    cv2.imwrite(str(tmp_path / 'small.png'), read_image(paths[0])[:400, :400])
    cv2.imwrite(str(tmp_path / 'mirrored.png'), read_image(paths[0])[:, ::-1])
    cv2.imwrite(str(tmp_path / 'nan.tiff'), np.full((768, 1024), np.nan, np.float32))
    bad = [tmp_path / name for name in ('notes.png', 'small.png', 'mirrored.png', 'nan.tiff')]
    done = calibrate(*paths, *bad, '-o', tmp_path / 'camera.yaml', '--fov-deg', 11.43,
                     '--epoch', 2019.57, '--json')
    assert done.exit_code == 0, done.stderr
    rows = {row['file']: row for row in json.loads(done.stdout)['rows']}
    assert sum(row['used'] for row in rows.values()) == len(paths)
    for name, words in (('notes.png', 'not an image'), ('mirrored.png', 'not identified'),
                        ('small.png', '400 x 400 px, the camera has 1024 x 768'),
                        ('nan.tiff', 'no finite pixel')):
        assert words in rows[name]['reason']


def test_a_camera_to_start_from(night_sky, tmp_path):
    start = tmp_path / 'start.yaml'
    save_camera(Camera.from_fov(1024, 768, 11.6), start)
    done = calibrate(*night_sky[0][:4], '-o', tmp_path / 'camera.yaml', '--camera', start,
                     '--free', 'k1')
    assert done.exit_code == 0, done.stderr
    camera = load_camera(tmp_path / 'camera.yaml')
    assert camera.fx == pytest.approx(5114, abs=4)
    assert (camera.cx, camera.cy) == (511.5, 383.5) and camera.distortion[0] > 0
    assert 'held' in done.stdout and 'left_out' in done.stdout


@pytest.mark.parametrize('images, words', [
    (['{sky}'], '1 identified images, at least 2 are needed'),
    (['{sky}'] * 3, 'all images have the same pointing'),
    (['/no/such.png'], '/no/such.png: No such file'),
])
def test_refusals_have_a_reason_and_status_1(night_sky, tmp_path, images, words):
    output = tmp_path / 'camera.yaml'
    paths = [image.format(sky=night_sky[0][3]) for image in images]
    done = calibrate(*paths, '-o', output, '--fov-deg', 11.43)
    assert done.exit_code == 1
    assert words in done.stderr
    assert not output.exists()


@pytest.mark.parametrize('arguments, words', [
    (['a.png', '-o', 'c.yaml'], 'give either --fov-deg or --camera'),
    (['a.png', '--fov-deg', '11'], "Missing option '-o'"),
    (['a.png', '-o', 'c.yaml', '--fov-deg', '400'], '400'),
    (['-o', 'c.yaml', '--fov-deg', '11'], 'IMAGES'),
    (['a.png', '-o', 'c.yaml', '--fov-deg', '11', '--free', 'k9'], 'k9'),
])
def test_wrong_use_of_calibrate_is_status_2(arguments, words):
    done = calibrate(*arguments)
    assert done.exit_code == 2
    assert words in done.stderr
