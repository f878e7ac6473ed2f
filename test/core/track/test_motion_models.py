# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Image motion against turned cameras."""

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from native_bank import body_rate, coordinated_turn, turn_curvature
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm
from skies import CAMERA
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import conjugate, quaternion_from_rotation_vector, rotate
from startracker_ros.core.track.motion_models import constant_velocity
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

CAMERAS = [CAMERA,
           Camera(1200, 900, 1500.0, 1520.0, 610.0, 440.0, (-0.2, 0.05, 1e-3, -2e-3, 0.01)),
           Camera(1200, 900, 460.0, 455.0, 610.0, 440.0, (-0.02, 0.005, -0.003, 4e-4),
                  'equidistant')]
RATES = arrays(float, 3, elements=st.floats(-0.03, 0.03))


def stars(camera, count=12):
    rng = np.random.default_rng(count)
    return rng.uniform(50, [camera.width - 50, camera.height - 50], (count, 2))


def turned(camera, uv, rate, dt_s):
    q = quaternion_from_rotation_vector(rate * dt_s)
    return camera.project(rotate(conjugate(q), camera.unproject(uv)))


def turn_system(rate):
    """Return the matrix (4, 4) of a velocity that turns."""
    return np.array([[0, 1, 0, 0], [0, 0, 0, -rate], [0, 0, 0, 1], [0, rate, 0, 0]], float)


@settings(max_examples=20)
@given(st.floats(0.01, 3), st.floats(-9, 9) | st.floats(-1e-3, 1e-3))
def test_coordinated_turn_against_its_integral(dt_s, rate):
    transition, noise = coordinated_turn(dt_s, rate, (0.4, 1.3))
    np.testing.assert_allclose(transition, expm(turn_system(rate) * dt_s), atol=1e-10)
    density = np.diag([0, 0.4 ** 2, 0, 1.3 ** 2])

    def arrived(t):
        after = expm(turn_system(rate) * (dt_s - t))
        return after @ density @ after.T

    expected = quad_vec(arrived, 0, dt_s, epsabs=1e-12, epsrel=1e-10)[0]
    np.testing.assert_allclose(noise, expected, rtol=1e-8, atol=1e-11)


@given(st.floats(0.01, 3), st.floats(-200, 200) | st.floats(-1e-6, 1e-6),
       st.tuples(st.floats(0, 3), st.floats(0, 3)))
def test_noise_of_a_turn_is_symmetric_and_positive(dt_s, rate, acceleration):
    noise = coordinated_turn(dt_s, rate, acceleration)[1]
    np.testing.assert_array_equal(noise, noise.T)
    # In units in which its elements are of one size.
    unit = np.array([dt_s ** 1.5, dt_s ** 0.5] * 2)
    assert np.linalg.eigvalsh(noise / np.outer(unit, unit)).min() > -1e-13


def test_a_slow_turn_is_constant_velocity():
    dt_s, s = 0.2, np.array([0.4, 1.3])
    expected = np.kron(np.diag(s ** 2), [[dt_s ** 3 / 3, dt_s ** 2 / 2], [dt_s ** 2 / 2, dt_s]])
    for rate in (0.0, 1e-300, 1e-12, -1e-12):
        transition, noise = coordinated_turn(dt_s, rate, tuple(s))
        np.testing.assert_allclose(transition, constant_velocity(dt_s, (0, 0))[0], atol=1e-12)
        np.testing.assert_allclose(noise, expected, rtol=1e-12, atol=1e-12)
    # What the turn brings from the other axis is lost in no rounding, however small.
    across = coordinated_turn(dt_s, 1e-6, (0.0, 1.0))[1][0, 0]
    assert across == pytest.approx(1e-12 * dt_s ** 5 / 20, rel=1e-9)


def test_stars_turn_with_a_camera_that_rolls():
    """The velocity of all stars turns by minus the body rate about the boresight."""
    camera, roll, dt_s = CAMERAS[0], 0.4, 0.5
    uv = stars(camera)
    jacobian = image_jacobian(camera, camera.unproject(uv))
    state = np.zeros((len(uv), 4))
    state[:, ::2], state[:, 1::2] = uv, jacobian @ [0, 0, roll]
    there = state @ coordinated_turn(dt_s, -roll, (0, 0))[0].T
    np.testing.assert_allclose(
        there[:, ::2], turned(camera, uv, np.array([0, 0, roll]), dt_s), atol=1e-8)


def test_behind_the_camera_is_nan():
    camera = CAMERAS[0]
    assert np.isnan(image_jacobian(camera, np.array([[0, 0, -1.0], [1, 0, 0]]))).all()
    assert np.isnan(turn_curvature(camera, stars(camera), np.array([2.0, 0, 0]), 1.0)).all()


@pytest.mark.parametrize('camera', CAMERAS)
@given(RATES)
@settings(max_examples=15)
def test_jacobian_is_the_velocity_of_the_image(camera, rate):
    uv = stars(camera)
    velocity = (turned(camera, uv, rate, 1e-3) - turned(camera, uv, rate, -1e-3)) / 2e-3
    jacobian = image_jacobian(camera, camera.unproject(uv))
    np.testing.assert_allclose(jacobian @ rate, velocity, atol=1e-5)


def test_pinhole_flow_as_published():
    """The flow of the extended grid paper, in this project's camera frame (y down)."""
    camera = CAMERAS[0]
    uv = stars(camera)
    x, y = (uv - [camera.cx, camera.cy]).T
    f, (wx, wy, wz) = camera.fx, (0.01, -0.02, 0.03)
    flow = np.stack([-f * wy + y * wz + (x * y * wx - x * x * wy) / f,
                     f * wx - x * wz + (y * y * wx - x * y * wy) / f], -1)
    jacobian = image_jacobian(camera, camera.unproject(uv))
    np.testing.assert_allclose(jacobian @ [wx, wy, wz], flow, atol=1e-5)


@pytest.mark.parametrize('camera', CAMERAS)
@given(RATES)
@settings(max_examples=15)
def test_curvature_makes_the_prediction_exact(camera, rate):
    uv, dt_s = stars(camera), 0.2
    jacobian = image_jacobian(camera, camera.unproject(uv))
    state = np.zeros((len(uv), 4))
    state[:, ::2], state[:, 1::2] = uv, jacobian @ rate
    predicted = state @ constant_velocity(dt_s, (0, 0))[0].T + turn_curvature(
        camera, uv, rate, dt_s)
    there = turned(camera, uv, rate, dt_s)
    np.testing.assert_allclose(predicted[:, ::2], there, atol=1e-5)
    there_jacobian = image_jacobian(camera, camera.unproject(there))
    np.testing.assert_allclose(predicted[:, 1::2], there_jacobian @ rate, atol=1e-5)


def test_body_rate_and_its_covariance():
    camera, rng = CAMERAS[1], np.random.default_rng(3)
    uv = stars(camera, 20)
    jacobian = image_jacobian(camera, camera.unproject(uv))
    covariance = rng.uniform(0.5, 2, 20)[:, None, None] * [[0.04, 0.01], [0.01, 0.09]]
    rate = np.array([0.003, -0.01, 0.02])
    root = np.linalg.cholesky(covariance)
    nees = []
    for _ in range(500):
        velocity = jacobian @ rate + np.einsum('nij,nj->ni', root, rng.normal(0, 1, (20, 2)))
        estimate, rate_covariance = body_rate(camera, uv, velocity, covariance)
        error = estimate - rate
        nees.append(error @ np.linalg.solve(rate_covariance, error))
    low, high = mean_chi_square_bounds(3, len(nees))
    assert low < np.mean(nees) < high, (low, np.mean(nees), high)
