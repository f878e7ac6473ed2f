# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras as drivers send them: what is applied, what is the same, and what is not a camera."""

from dataclasses import dataclass, field, replace
import time

import numpy as np
import pytest
from startracker_ros.core.camera.calibrated import (
    check_pixels, check_sensor, LARGEST_PIXEL_DEG)
from startracker_ros.core.camera.distortion import EQUIDISTANT, RATIONAL
from startracker_ros.core.camera.model import Camera, CameraError, SAME_PX
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.io.bags.layouts import camera_from_message
from startracker_ros.io.images.camera_files import load_camera, save_camera

LENS = Camera(1024, 768, 2500.0, 2490.0, 520.0, 377.0, (-0.1, 0.02, 1e-3, -2e-3, 0.1))
FISHEYE = Camera(2560, 1920, 600.0, 602.0, 1300.0, 940.0, (-0.02, 0.005, -0.003, 4e-4),
                 EQUIDISTANT)
FRACTION = (-0.1, 0.02, 1e-3, -2e-3, 0.1, 0.05, 0.01, 0.02)


@dataclass
class Roi:
    """sensor_msgs/RegionOfInterest."""

    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0


@dataclass
class Info:
    """sensor_msgs/CameraInfo."""

    width: int = 1024
    height: int = 768
    distortion_model: str = 'plumb_bob'
    d: tuple = ()
    k: tuple = (2500.0, 0.0, 520.0, 0.0, 2490.0, 377.0, 0.0, 0.0, 1.0)
    p: tuple = (0.0,) * 12
    binning_x: int = 0
    binning_y: int = 0
    roi: Roi = field(default_factory=Roi)


def matrix(fx, fy, cx, cy):
    return fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0


@pytest.mark.parametrize('model, d, expected', [
    ('', (), (0.0,) * 5),
    ('', (-0.1, 0.0, 0.0, 0.0), (-0.1, *[0.0] * 4)),
    ('equidistant', (), (0.0,) * 4),
    (RATIONAL, FRACTION, FRACTION),
    (RATIONAL, FRACTION[:5], (*FRACTION[:5], 0.0, 0.0, 0.0)),
    # As OpenCV with CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL writes them.
    (RATIONAL, (*FRACTION, *[0.0] * 4), FRACTION),
    (RATIONAL, (*FRACTION, *[0.0] * 6), FRACTION),
    ('plumb_bob', (*LENS.distortion, 0.0, 0.0, 0.0), LENS.distortion)])
def test_terms_that_are_left_out_or_beyond_those_of_the_model_are_zero(model, d, expected):
    assert camera_from_message(Info(distortion_model=model, d=d)).distortion == expected


@pytest.mark.parametrize('model, d, words', [
    (RATIONAL, (*FRACTION, 0.0, 1e-4, 0.0, 0.0), '8 distortion terms, got 12: .*thin prism'),
    ('equidistant', (0.1,) * 5, 'equidistant has 4 distortion terms, got 5'),
    ('fov', (0.1,), "'fov' is not one of plumb_bob")])
def test_terms_that_no_model_has_are_named(model, d, words):
    with pytest.raises(CameraError, match=words):
        camera_from_message(Info(distortion_model=model, d=d))


def test_a_rectified_image_has_its_camera_in_p():
    p = (2400.0, 0.0, 500.0, -7.0, 0.0, 2410.0, 380.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    info = Info(k=(0.0,) * 9, p=p, d=(0.0,) * 5)
    assert camera_from_message(info) == Camera(1024, 768, 2400.0, 2410.0, 500.0, 380.0)
    assert camera_from_message(replace(info, k=Info.k)).fx == 2500.0
    with pytest.raises(CameraError, match='D has distortion terms but K is empty'):
        camera_from_message(replace(info, d=LENS.distortion))
    with pytest.raises(CameraError, match='must be positive'):
        camera_from_message(replace(info, p=(0.0,) * 12))


@pytest.mark.parametrize('lens', [LENS, FISHEYE])
def test_binning_and_roi_are_applied_as_image_geometry_does(lens):
    """A pixel of the smaller image has the direction of its place on the sensor."""
    info = Info(lens.width, lens.height, lens.distortion_model, lens.distortion,
                matrix(lens.fx, lens.fy, lens.cx, lens.cy))
    small = camera_from_message(replace(
        info, binning_x=2, binning_y=4, roi=Roi(700, 101, 301, 400)))
    assert (small.width, small.height) == (150, 100)
    pixels = np.random.default_rng(2).uniform([0, 0], [149, 99], (50, 2))
    np.testing.assert_allclose(small.unproject(pixels),
                               lens.unproject(pixels * [2, 4] + [700, 101]), atol=1e-12)
    for roi in (Roi(), Roi(0, 0, lens.width, lens.height)):
        for binning in (0, 1):
            assert camera_from_message(replace(
                info, binning_x=binning, binning_y=binning, roi=roi)) == lens


@pytest.mark.parametrize('changes, words', [
    ({'roi': Roi(1000, 0, 100, 100)}, r'roi of 100 x 100 px at \(1000, 0\) is not in the image'),
    ({'roi': Roi(16, 0, 0, 0)}, 'roi of 0 x 0 px'),
    ({'binning_x': 2000}, 'binning of 2000 x 1 px'),
    # A matrix of the binned image next to the size of the whole one: avt_vimba_camera 82.
    ({'width': 2064, 'height': 1544, 'binning_x': 4, 'binning_y': 4,
      'k': matrix(299.5, 300.1, 254.1, 183.9)}, 'in a corner of the image of 2064 x 1544'),
    # Identity, in shares of the width, in mm, transposed.
    ({'k': matrix(1.0, 1.0, 0.0, 0.0)}, r'focal length 1, 1 px'),
    ({'width': 2, 'height': 2, 'k': matrix(1.0, 1.0, 0.0, 0.0)}, 'pixel is 57 deg wide'),
    ({'k': matrix(1.2, 1.6, 0.5, 0.5)}, 'focal length 1.2, 1.6 px'),
    ({'k': matrix(50.0, 50.0, 511.5, 383.5)}, 'pixel is 1.1 deg wide'),
    ({'k': (2500.0, 0.0, 0.0, 0.0, 2490.0, 0.0, 520.0, 377.0, 1.0)}, 'by rows'),
    ({'k': (2500.0, 3.0, 520.0, 0.0, 2490.0, 377.0, 0.0, 0.0, 1.0)}, 'by rows'),
    # Without a principal point, on one side of the image, of another image size.
    ({'k': matrix(2500.0, 2500.0, 0.0, 0.0)}, r'principal point \(0, 0\) px is not set'),
    ({'k': matrix(2500.0, 2500.0, 0.0, 383.5)}, r'principal point \(0, 383.5\) px is not within'),
    ({'k': matrix(2500.0, 2500.0, 511.5, -300.0)}, 'is not within the image'),
    ({'k': matrix(2500.0, 2500.0, 5000.0, 383.5)}, 'far off the image'),
    ({'k': matrix(1250.0, 1250.0, 255.5, 191.5)}, 'K is of another image size'),
    ({'k': matrix(5000.0, 5000.0, 1023.5, 767.5)}, 'K is of another image size'),
    ({'k': matrix(2500.0, 500.0, 511.5, 383.5)}, 'pixels of 5 : 1'),
    # The image of the whole sensor is one, but not that of binned pixels.
    ({'binning_x': 16, 'binning_y': 16, 'k': matrix(1000.0, 1000.0, 511.5, 383.5)},
     'pixel is 0.92 deg wide')])
def test_what_cannot_be_a_camera_is_named_at_once(changes, words):
    begin_s = time.thread_time()
    with pytest.raises(CameraError, match=words):
        camera_from_message(replace(Info(), **changes))
    assert time.thread_time() - begin_s < 0.5


def test_a_part_of_a_sensor_may_be_on_one_side_of_the_optical_axis():
    check_sensor(LENS)
    corner = LENS.cropped(900, 700, 100, 60)
    assert corner.cx == LENS.cx - 900
    with pytest.raises(CameraError, match='not within'):
        check_sensor(corner)


def test_camera_files_are_read_as_messages_are(tmp_path):
    path = tmp_path / 'camera.yaml'

    def load(lens, **changes):
        save_camera(lens, path)
        text = path.read_text()
        for old, new in changes.values():
            assert old in text
            text = text.replace(old, new)
        path.write_text(text)
        return load_camera(path)
    rational = replace(LENS, distortion_model=RATIONAL, distortion=FRACTION)
    assert load(rational, d=('0.01, 0.02]', '0.01, 0.02, 0.0, 0.0, 0.0, 0.0]')) == rational
    for lens, words in ((replace(LENS, fx=100.0, fy=100.0, distortion=(0.0,) * 5), 'deg wide'),
                        (replace(LENS, cx=0.0, cy=0.0), 'is not set'),
                        (replace(LENS, cx=5000.0), 'far off')):
        with pytest.raises(CameraError, match=f'{path}: .*{words}'):
            load(lens)
    # Of a crop that was calibrated.
    assert load(replace(LENS, cx=-100.0, cy=20.0)).cx == -100.0


@pytest.mark.parametrize('lens', [
    LENS, FISHEYE, Camera.from_fov(4096, 3000, 20.0),
    # With an image circle.
    Camera(800, 600, 250.0, 250.0, 410.0, 290.0, (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880),
           EQUIDISTANT)])
def test_a_camera_is_the_same_within_what_a_star_could_show(lens):
    rng = np.random.default_rng(1)
    for _ in range(20):
        fx, fy = np.array([lens.fx, lens.fy]) * (1 + rng.uniform(-1e-7, 1e-7, 2))
        other = replace(lens, fx=float(fx), fy=float(fy))
        assert lens.is_same(other) and other.is_same(lens) and other != lens
    # The same lens through numbers of single precision.
    single = {name: float(np.float32(getattr(lens, name))) for name in ('fx', 'fy', 'cx', 'cy')}
    assert lens.is_same(replace(lens, **single, distortion=tuple(
        float(np.float32(term)) for term in lens.distortion)))
    for other in (replace(lens, fx=lens.fx * (1 + 1e-4)), replace(lens, cy=lens.cy + 0.01),
                  replace(lens, distortion=(lens.distortion[0] + 1e-3, *lens.distortion[1:])),
                  replace(lens, width=lens.width + 1)):
        assert not lens.is_same(other) and not other.is_same(lens)
    assert not lens.is_same(None)
    assert lens.difference_px(replace(lens, cx=lens.cx + 2 * SAME_PX)) == pytest.approx(
        2 * SAME_PX, rel=1e-3)


def test_no_catalogue_is_built_for_pixels_without_stars():
    """The library too: at 1 deg a pixel it would take seconds, at 57 deg minutes and 4 GB."""
    coarse = Camera.from_fov(64, 64, 60.0)
    for build in (lambda: check_pixels(coarse), lambda: StarTracker(coarse, 2026.5),
                  lambda: onboard_catalog(load_catalog(), coarse, 2026.5)):
        begin_s = time.thread_time()
        with pytest.raises(CameraError, match=f'more than {LARGEST_PIXEL_DEG:g} resolve no stars'):
            build()
        assert time.thread_time() - begin_s < 2.0
