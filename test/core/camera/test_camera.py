# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Camera model: round trips, agreement with OpenCV, refusal of nonsense."""

from dataclasses import replace

import cv2
from hypothesis import given, strategies as st
import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.io.images.camera_files import load_camera, save_camera

LENS = Camera(1024, 768, 5000.0, 5010.0, 511.0, 380.0, (-0.1, 0.02, 1e-3, -2e-3, 0.1))


@given(st.floats(-0.4, 0.2), st.floats(-0.05, 0.05), st.floats(-2e-3, 2e-3),
       st.floats(-2e-3, 2e-3), st.floats(5, 60))
def test_round_trip_below_a_millionth_of_a_pixel(k1, k2, p1, p2, fov_deg):
    ideal = Camera.from_fov(800, 600, fov_deg)
    camera = replace(ideal, distortion=(k1, k2, p1, p2, 0.0))
    u, v = np.meshgrid(np.linspace(-0.5, 799.5, 23), np.linspace(-0.5, 599.5, 19))
    pixels = np.stack([u, v], -1)
    assert np.abs(camera.project(camera.unproject(pixels)) - pixels).max() < 1e-6


def test_agrees_with_opencv():
    rng = np.random.default_rng(1)
    directions = LENS.unproject(rng.uniform([0, 0], [1024, 768], (200, 2)))
    matrix = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1]])
    expected, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), matrix,
                                    np.array(LENS.distortion))
    np.testing.assert_allclose(LENS.project(directions), expected[:, 0], atol=1e-8)


def test_field_of_view_is_edge_to_edge():
    camera = Camera.from_fov(1024, 512, 12.0)
    assert np.degrees(camera.fov_x_rad) == pytest.approx(12.0, abs=1e-12)
    edges = camera.unproject(np.array([[-0.5, camera.cy], [1023.5, camera.cy]]))
    assert np.degrees(np.arccos(edges[0] @ edges[1])) == pytest.approx(12.0, abs=1e-9)
    corner = camera.unproject(np.array([-0.5, -0.5]))
    assert camera.corner_angle_rad == pytest.approx(np.arccos(corner[2]), abs=1e-12)


def test_behind_the_camera_is_not_a_pixel():
    assert np.isnan(LENS.project(np.array([0.0, 0.0, -1.0]))).all()


def test_file_round_trip(tmp_path):
    save_camera(LENS, tmp_path / 'camera.yaml')
    assert load_camera(tmp_path / 'camera.yaml') == LENS


@pytest.mark.parametrize('change, words', [
    ({'width': 0}, 'image size 0 x 768'),
    ({'fx': -5.0}, 'focal length'),
    ({'fy': float('nan')}, 'NaN'),
    ({'cx': 1e5}, 'principal point'),
    ({'fx': 1.0}, 'field of view'),
    ({'distortion': (-200.0, 0.0, 0.0, 0.0, 0.0)}, 'folds'),
    ({'distortion': (0.0, 0.0)}, '5 distortion terms'),
])
def test_nonsense_is_refused_by_name(change, words):
    with pytest.raises(CameraError, match=words):
        replace(LENS, **change)


@pytest.mark.parametrize('text, words', [
    ('just words', 'not a ROS camera calibration'),
    ('{a: [', 'not a ROS camera calibration'),
    ('distortion_model: plumb_bob\ncamera_matrix: {data: [1, 2]}', 'not a ROS camera'),
])
def test_bad_files_are_refused_by_name(tmp_path, text, words):
    path = tmp_path / 'camera.yaml'
    path.write_text(text)
    with pytest.raises(CameraError, match=words) as caught:
        load_camera(path)
    assert str(path) in str(caught.value)
    save_camera(LENS, path)
    path.write_text(path.read_text().replace('plumb_bob', 'fisheye'))
    with pytest.raises(CameraError, match="'fisheye' is not one of plumb_bob"):
        load_camera(path)
    with pytest.raises(CameraError, match='No such file'):
        load_camera(tmp_path / 'absent.yaml')
