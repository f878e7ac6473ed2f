# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The lens of each distortion model against OpenCV."""

from dataclasses import replace

import cv2
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from startracker_ros.core.camera.distortion import EQUIDISTANT, plane_points, RATIONAL, rays
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.io.images.camera_files import load_camera, save_camera

PLUMB = Camera(1024, 768, 1500.0, 1480.0, 520.0, 380.0, (-0.2, 0.08, 1e-3, -5e-4, 0.01))
FRACTION = Camera(1024, 768, 900.0, 880.0, 520.0, 380.0,
                  (0.4, 0.1, 1e-3, -5e-4, 0.01, 0.7, 0.2, 0.02), RATIONAL)
FISHEYE = Camera(1280, 960, 470.0, 465.0, 650.0, 470.0, (-0.02, 0.005, -0.003, 4e-4),
                 EQUIDISTANT)
ALL = pytest.mark.parametrize('camera', [PLUMB, FRACTION, FISHEYE],
                              ids=['plumb_bob', 'rational', 'equidistant'])


def grid(camera, count=21):
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, count),
                       np.linspace(-0.5, camera.height - 0.5, count))
    return np.stack([u, v], -1).reshape(-1, 2)


def by_opencv(camera, directions):
    """Return the pixels of directions in front of the camera."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    nothing, terms = np.zeros(3), np.array(camera.distortion)
    if camera.distortion_model == EQUIDISTANT:
        return cv2.fisheye.projectPoints(directions[:, None], nothing, nothing, matrix,
                                         terms)[0][:, 0]
    return cv2.projectPoints(directions, nothing, nothing, matrix, terms)[0][:, 0]


@ALL
def test_pixels_are_those_of_opencv(camera):
    directions = camera.unproject(grid(camera))
    ahead = directions[:, 2] > 0.02
    assert ahead.mean() > 0.8
    np.testing.assert_allclose(camera.project(directions[ahead]),
                               by_opencv(camera, directions[ahead]), atol=1e-8)


@ALL
def test_pixels_come_back(camera):
    pixels = grid(camera)
    np.testing.assert_allclose(camera.project(camera.unproject(pixels)), pixels, atol=1e-9)


@given(st.floats(-0.06, 0.05), st.floats(-0.01, 0.01), st.floats(30, 150))
@settings(max_examples=30, deadline=None)
def test_a_fisheye_is_undone_beyond_a_right_angle(k1, k2, fov_deg):
    camera = Camera.from_fov(800, 800, fov_deg, EQUIDISTANT)
    try:
        camera = replace(camera, distortion=(k1, k2, 0.0, 0.0))
    except CameraError:
        return
    pixels = grid(camera)
    direction = camera.unproject(pixels)
    seen = np.isfinite(direction).all(axis=1)
    # Corners may be outside an image circle.
    assert seen.all() or camera.farthest_rad > np.radians(65)
    np.testing.assert_allclose(camera.project(direction[seen]), pixels[seen], atol=1e-7)


def test_a_fisheye_of_180_deg_sees_its_sides():
    camera = Camera.from_fov(1000, 500, 180.0, EQUIDISTANT)
    assert np.degrees(camera.seen_x_rad) == pytest.approx(180.0, abs=1e-9)
    assert np.degrees(camera.fov_x_rad) == pytest.approx(180.0, abs=1e-9)
    assert np.degrees(camera.seen_y_rad) == pytest.approx(90.0, abs=1e-9)
    np.testing.assert_allclose(camera.project([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]),
                               [[999.5, 249.5], [-0.5, 249.5]], atol=1e-9)
    assert np.degrees(camera.corner_angle_rad) > 100
    assert np.isnan(camera.project([0.0, 0.0, -1.0])).all()
    np.testing.assert_array_equal(camera.project([0.0, 0.0, 1.0]), [499.5, 249.5])


def test_an_image_may_be_far_wider_than_the_sky_in_it():
    """Of a stereographic lens: 3.5 focal lengths from its axis are 120 deg."""
    camera = Camera(1920, 1080, 250.0, 250.0, 900.0, 540.0,
                    (1 / 12, 1 / 120, 17 / 20160, 31 / 362880), EQUIDISTANT)
    pixel = np.array([[900.0 + 250.0 * 2 * np.tan(np.radians(30.0)), 540.0]])
    assert np.degrees(np.arccos(camera.unproject(pixel)[0, 2])) == pytest.approx(60.0, abs=0.01)
    # The left edge of an ideal one would be at 206 deg: there is no sky.
    ideal = Camera(1920, 1080, 250.0, 250.0, 900.0, 540.0, (0.0,) * 4, EQUIDISTANT)
    assert np.isnan(ideal.unproject(np.array([[0.0, 540.0]]))).all()


@pytest.mark.parametrize('equidistant', [False, True])
def test_plane_points_are_undone(equidistant):
    vectors = np.random.default_rng(1).standard_normal((100, 3))
    vectors[0] = [0, 0, 1]
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    if not equidistant:
        vectors[:, 2] = abs(vectors[:, 2])
    np.testing.assert_allclose(rays(equidistant, plane_points(equidistant, vectors)), vectors,
                               atol=1e-12)


@ALL
def test_files_hold_every_model(camera, tmp_path):
    save_camera(camera, tmp_path / 'camera.yaml')
    assert load_camera(tmp_path / 'camera.yaml') == camera


def test_outside_the_circle_of_a_fisheye_is_not_a_direction():
    """Orthographic, sin(theta) as a series: all that it sees is within the focal length."""
    camera = Camera(800, 600, 250.0, 250.0, 410.0, 290.0,
                    (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880), EQUIDISTANT)
    at_60_deg = camera.unproject([410.0 + 250.0 * np.sin(np.radians(60)), 290.0])
    np.testing.assert_allclose(at_60_deg, [np.sqrt(3) / 2, 0, 0.5], atol=1e-6)
    assert np.isnan(camera.unproject([[0.0, 0.0], [410.0, 560.0]])).all()
    # What is behind the lens would otherwise be folded into its image.
    assert np.isnan(camera.project([0.5, 0.0, -1.0])).all()
    assert camera.corner_angle_rad == pytest.approx(np.pi / 2, abs=0.01)
    assert camera.seen_x_rad == pytest.approx(np.pi, abs=0.02)
    assert camera.seen_y_rad == pytest.approx(np.pi, abs=0.02)


def test_a_fisheye_shows_all_within_its_circle():
    """At 94 deg the radius is at its largest, 2.2 focal lengths: more than the angle, 1.6 rad."""
    camera = Camera(1000, 1000, 305.0, 305.0, 436.0, 544.5,
                    (0.043, 0.0565, -0.00928, -0.00458), EQUIDISTANT)
    theta = np.radians(np.arange(1.0, 93.5))
    direction = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    np.testing.assert_allclose(camera.unproject(camera.project(direction)), direction, atol=1e-9)


def test_a_fisheye_that_folds_too_early_or_sees_all_around_is_rejected():
    with pytest.raises(CameraError, match='folds'):
        replace(Camera.from_fov(800, 800, 150, EQUIDISTANT), distortion=(-0.3, 0.0, 0.0, 0.0))
    with pytest.raises(CameraError, match='350'):
        Camera.from_fov(800, 100, 350, EQUIDISTANT)
