# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""EXIF: orientation and field of view, and files without it."""

import cv2
import numpy as np
from PIL import Image, ImageOps
import pytest
from startracker_ros.io.images.exif import read_exif
from startracker_ros.io.images.images import image_paths, Photograph, read_image, read_photograph


def save(path, tags=(), details=(), size=(60, 40)):
    image = np.zeros(size[::-1], np.uint8)
    image[3:8, 5:20] = 200
    picture = Image.fromarray(image)
    exif = picture.getexif()
    exif.update(dict(tags))
    exif[0x8769] = dict(details)
    picture.save(path, exif=exif)
    return path


@pytest.mark.parametrize('orientation', range(1, 9))
def test_images_are_turned_as_pillow_turns_them(tmp_path, orientation):
    path = save(tmp_path / 'a.png', {0x0112: orientation})
    with Image.open(path) as picture:
        expected = np.array(ImageOps.exif_transpose(picture))
    np.testing.assert_array_equal(read_image(path), expected)


def test_the_field_of_view_by_the_equivalent_focal_length(tmp_path):
    path = save(tmp_path / 'a.jpg', details={0xa405: 26}, size=(400, 300))
    # The diagonal of 43.27 mm of full frame, of which the long side of 4:3 has 0.8.
    expected = np.degrees(2 * np.arctan(0.8 * 43.27 / 2 / 26))
    assert read_photograph(path).fov_deg == pytest.approx(expected)


def test_the_field_of_view_by_the_sensor(tmp_path):
    path = save(tmp_path / 'a.jpg', details={0x920a: 50.0, 0xa20e: 100.0, 0xa210: 4,
                                             0xa002: 2400}, size=(240, 160))
    assert read_photograph(path).fov_deg == pytest.approx(np.degrees(2 * np.arctan(12 / 50)))


@pytest.mark.parametrize('content', [b'', b'\xff\xd8\xff\xe1\x00\x10Exif\0\0II*\0', b'BM'])
def test_damaged_files_have_no_exif(content):
    assert read_exif(content) == (1, None, None)


def test_an_image_without_exif(tmp_path):
    cv2.imwrite(str(tmp_path / 'a.png'), np.ones((4, 6), np.uint8))
    photograph = read_photograph(tmp_path / 'a.png')
    assert photograph[1:] == Photograph(photograph.image)[1:]
    assert photograph.fov_deg is None and photograph.taken is None


def test_folders_and_patterns_are_lists_of_images(tmp_path):
    for name in ('b.png', 'a.JPG', 'notes.txt', 'solutions.csv'):
        (tmp_path / name).touch()
    both = [tmp_path / 'a.JPG', tmp_path / 'b.png']
    assert image_paths([tmp_path]) == both
    assert image_paths([tmp_path / '*.[pJ]*']) == both
    assert image_paths([tmp_path / 'absent.png']) == [tmp_path / 'absent.png']
    assert image_paths([tmp_path / '*.fits']) == [tmp_path / '*.fits']


@pytest.mark.parametrize('offset, unix_s', [
    ('+02:00', 1564433246), ('-05:30', 1564433246 + 27000), ('Z', 1564440446)])
def test_the_time_with_its_zone(tmp_path, offset, unix_s):
    path = save(tmp_path / 'a.jpg', details={0x9003: '2019:07:29 22:47:26', 0x9011: offset})
    assert read_photograph(path).taken == (unix_s * 10 ** 9, True, 'EXIF')


@pytest.mark.parametrize('details', [{}, {0x9011: '   :  '}, {0x9011: '\0'}])
def test_a_time_without_a_zone_counts_as_utc(tmp_path, details):
    path = save(tmp_path / 'a.jpg', details={0x9003: '2019:07:29 20:47:26', **details})
    assert read_photograph(path).taken == (1564433246 * 10 ** 9, False, 'EXIF')


@pytest.mark.parametrize('text', ['0000:00:00 00:00:00', '    :  :     :  :  ', 'noon', ''])
def test_a_time_that_is_invalid(tmp_path, text):
    path = save(tmp_path / 'a.jpg', details={0x9003: text})
    assert read_photograph(path).taken is None
