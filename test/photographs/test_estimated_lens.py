# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of the lens that is fitted to one image."""

from native_core import call
import numpy as np
import pytest
from startracker_ros.core.camera.distortion import EQUIDISTANT
from startracker_ros.core.camera.model import Camera, project
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_pointing, rotate
from startracker_ros.photographs.lens_fit import changed, lens_of, stars_in_image


PINHOLE = Camera(640, 480, 500.0, 510.0, 330.0, 230.0, (-0.2, 0.05, 1e-3, -2e-3, 0.01))
FISHEYE = Camera(640, 480, 200.0, 205.0, 330.0, 230.0, (-0.05, 0.01, -2e-3, 1e-4), EQUIDISTANT)


@pytest.mark.parametrize('camera, spread, parameters', [(PINHOLE, 0.4, 8), (FISHEYE, 3.0, 11)])
def test_the_derivatives_are_those_of_the_pixels(camera, spread, parameters):
    quaternion = quaternion_from_pointing(1.0, 0.3, 0.4)
    lens = lens_of(camera.native, quaternion)

    def linearised(change):
        """Return pixels (N, 2) of the stars and derivatives (N, 2, P)."""
        found = np.empty((20, 2)), np.empty((20, 2, 11))
        for star, pixel, partial in zip(icrf, *found):
            call('stt_linearised', lens['camera'], quaternion, np.append(
                change, np.zeros(11 - parameters)), star, parameters, pixel, partial)
        return found[0], found[1][:, :, :parameters]

    across = np.random.default_rng(1).uniform(-spread, spread, (20, 2))
    sensor = np.column_stack([across, np.ones(20)])
    icrf = rotate(quaternion, sensor / np.linalg.norm(sensor, axis=1, keepdims=True))
    base, partial = linearised(np.zeros(parameters))
    np.testing.assert_allclose(base, camera.project(sensor), atol=1e-9)
    for parameter in range(parameters):
        step = np.zeros(parameters)
        step[parameter] = 1e-6
        after, before = (linearised(sign * step)[0] for sign in (1, -1))
        numeric = (after - before) / 2e-6
        np.testing.assert_allclose(partial[:, :, parameter], numeric, atol=1e-5)
        other = changed(lens, step)
        np.testing.assert_allclose(project(other['camera'], rotate(conjugate(
            other['quaternion']), icrf)), after, atol=1e-9)


def test_a_star_behind_the_camera_is_not_in_the_image():
    q = quaternion_from_pointing(1.0, 0.3, 0.4)
    lens = lens_of(Camera.from_fov(640, 480, 30.0).native, q)
    axis = rotate(q, [0.0, 0.0, 1.0])
    index, pixel = stars_in_image(lens, np.array([-axis, axis]))
    np.testing.assert_array_equal(index, [1])
    np.testing.assert_allclose(pixel, [[319.5, 239.5]])


def test_the_stars_in_the_image_are_those_that_the_camera_shows():
    camera = PINHOLE
    q = quaternion_from_pointing(1.0, 0.3, 0.4)
    icrf = np.random.default_rng(2).standard_normal((3000, 3))
    icrf /= np.linalg.norm(icrf, axis=1, keepdims=True)
    index, pixel = stars_in_image(lens_of(camera.native, q), icrf)
    sensor = rotate(conjugate(q), icrf)
    uv = camera.project(sensor)
    near = sensor[:, 2] >= np.cos(camera.corner_angle_rad)
    np.testing.assert_array_equal(index, np.flatnonzero(near & camera.contains(uv)))
    np.testing.assert_allclose(pixel, uv[index], atol=1e-9)
    assert len(index) > 30
