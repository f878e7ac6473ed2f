"""Image motion against turned cameras."""

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from startracker_ros.camera import Camera
from startracker_ros.rotation import conjugate, quaternion_from_rotation_vector, rotate
from startracker_ros.track.motion_models import (
    body_rate, constant_velocity, image_jacobian, turn_curvature)

CAMERAS = [Camera.from_fov(1024, 1024, 12.0),
           Camera(1200, 900, 1500.0, 1520.0, 610.0, 440.0, (-0.2, 0.05, 1e-3, -2e-3, 0.01))]
RATES = arrays(float, 3, elements=st.floats(-0.03, 0.03))


def stars(camera, count=12):
    rng = np.random.default_rng(count)
    return rng.uniform(50, [camera.width - 50, camera.height - 50], (count, 2))


def turned(camera, uv, rate, dt_s):
    q = quaternion_from_rotation_vector(rate * dt_s)
    return camera.project(rotate(conjugate(q), camera.unproject(uv)))


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
    jacobian = image_jacobian(camera, camera.unproject(stars(camera, 20)))
    covariance = rng.uniform(0.5, 2, 20)[:, None, None] * [[0.04, 0.01], [0.01, 0.09]]
    rate = np.array([0.003, -0.01, 0.02])
    root = np.linalg.cholesky(covariance)
    nees = []
    for _ in range(500):
        velocity = jacobian @ rate + np.einsum('nij,nj->ni', root, rng.normal(0, 1, (20, 2)))
        estimate, rate_covariance = body_rate(jacobian, velocity, covariance)
        error = estimate - rate
        nees.append(error @ np.linalg.solve(rate_covariance, error))
    assert np.mean(nees) == pytest.approx(3, abs=0.4)
