"""The compiled lens against OpenCV."""

import cv2
import numpy as np
from startracker_ros.camera.lens import undistort, undistort_all
from startracker_ros.camera.model import Camera

CAMERA = Camera(1024, 768, 1500.0, 1480.0, 520.0, 380.0, (-0.2, 0.08, 1e-3, -5e-4, 0.01))


def test_distortion_is_undone_as_opencv_does_it():
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [1023, 767], (200, 2))
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    seen = undistort_all(CAMERA.lens, (pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy])
    points = np.column_stack([seen, np.ones(len(seen))])
    shown, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix,
                                 np.array(CAMERA.distortion))
    np.testing.assert_allclose(shown[:, 0], pixels, atol=1e-9)
    np.testing.assert_allclose(CAMERA.project(CAMERA.unproject(pixels)), pixels, atol=1e-9)


def test_a_pinhole_changes_nothing():
    assert undistort(Camera.from_fov(512, 512, 10.0).lens, 0.07, -0.03) == (0.07, -0.03)
