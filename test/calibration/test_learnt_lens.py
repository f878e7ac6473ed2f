"""Derivatives of the lens that is fitted to one image."""

import numpy as np
import pytest
from startracker_ros.calibration.learnt_lens import _Lens
from startracker_ros.camera.model import Camera
from startracker_ros.maths.rotation import quaternion_from_pointing, rotate


@pytest.mark.parametrize('parameter', range(8))
def test_the_derivatives_are_those_of_the_pixels(parameter):
    camera = Camera(640, 480, 500.0, 510.0, 330.0, 230.0, (-0.2, 0.05, 1e-3, -2e-3, 0.01))
    quaternion = quaternion_from_pointing(1.0, 0.3, 0.4)
    lens = _Lens(camera, quaternion)
    sensor = np.column_stack([np.random.default_rng(1).uniform(-0.4, 0.4, (20, 2)), np.ones(20)])
    icrf = rotate(quaternion, sensor / np.linalg.norm(sensor, axis=1, keepdims=True))
    base, partial = lens.linearised(icrf)
    np.testing.assert_allclose(base, camera.project(sensor), atol=1e-9)
    np.testing.assert_array_equal(base, lens.pixels(icrf))
    step = np.zeros(8)
    step[parameter] = 1e-6
    numeric = (lens.changed(step).pixels(icrf) - lens.changed(-step).pixels(icrf)) / 2e-6
    np.testing.assert_allclose(partial[:, :, parameter], numeric, atol=1e-5)


def test_a_star_behind_the_camera_has_no_pixel():
    lens = _Lens(Camera.from_fov(640, 480, 30.0), quaternion_from_pointing(1.0, 0.3, 0.4))
    assert np.isnan(lens.pixels(-rotate(lens.quaternion, [[0.0, 0.0, 1.0]]))).all()
