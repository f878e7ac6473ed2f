# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How star images move: constant velocity, coordinated turn, and under a turn of the camera.

The state of one star is [u, u_rate, v, v_rate] in px and px/s. Under the body rate w
(rad/s, sensor axes) a direction d in the sensor frame changes by -w x d.
"""

from math import cos, factorial, sin

import numpy as np
from startracker_ros.core.camera.lens import (
    distort, distortion_jacobian, Lens, plane_point, ray, rays, undistort, undistorted)
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_rotation_vector
from startracker_ros.core.track.innovation import normal_equations

POSITION = [0, 2]
VELOCITY = [1, 3]

# Of the sine from the fifth power on, the highest first; enough for arguments up to 2.
_SERIES = [1 / factorial(power) for power in range(27, 4, -2)]


def constant_velocity(dt_s: float, acceleration_px_s2: tuple[float, float]
                      ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the transition (4, 4) and process noise (4, 4) of the CV model.

    White acceleration of 1-sigma (u, v), constant within the step: Q = E diag(s^2) E^T
    (Sadeghi, Sabahi and Saberali). dt_s > 0.
    """
    half = dt_s * dt_s / 2
    transition = np.array([[1, dt_s, 0, 0], [0, 1, 0, 0], [0, 0, 1, dt_s], [0, 0, 0, 1]], float)
    effect = np.array([[half, 0], [dt_s, 0], [0, half], [0, dt_s]]) * acceleration_px_s2
    return transition, effect @ effect.T


def coordinated_turn(dt_s: float, rate_rad_s: float, acceleration: tuple[float, float]
                     ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the transition (4, 4) and process noise (4, 4) of the CT model.

    The velocity turns by rate_rad_s from u towards v, as that of all stars does when the
    camera turns about its boresight by -rate_rad_s (body rate z). acceleration are the
    square roots of the spectral densities (u, v) of white noise that acts throughout the
    step, px/s^1.5: Q = integral of e^(At) diag(0, s^2) e^(At)^T over the step (Sadeghi, Sabahi
    and Saberali). A 1-sigma of constant_velocity compares to s / sqrt(dt_s). Any finite
    rate, dt_s > 0.
    """
    angle = rate_rad_s * dt_s
    sine, cosine = sin(angle), cos(angle)
    along, across = dt_s * _sinc(angle), dt_s * angle / 2 * _sinc(angle / 2) ** 2
    transition = np.array([[1.0, along, 0.0, -across], [0.0, cosine, 0.0, -sine],
                           [0.0, across, 1.0, along], [0.0, sine, 0.0, cosine]])
    own, other, between = _turned_noise(dt_s, angle)
    u, v = np.square(acceleration)
    noise = np.empty((4, 4))
    noise[:2, :2] = u * own + v * other
    noise[2:, 2:] = u * other + v * own
    noise[:2, 2:] = u * between - v * between.T
    noise[2:, :2] = noise[:2, 2:].T
    return transition, noise


def _turned_noise(dt_s: float, angle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the integrals (2, 2) of a a^T, b b^T and a b^T over the step.

    An impulse at time t before the end of the step changes position and velocity along
    itself by a = [sin(wt) / w, cos(wt)], and across itself by
    b = [(1 - cos(wt)) / w, sin(wt)]; angle is w dt_s.
    """
    square = angle * angle
    sinc, half = _sinc(angle) ** 2, _sinc(angle / 2) ** 4
    fifth, fifth_of_double = _fifth_remainder(angle), _fifth_remainder(2 * angle)
    # (2 angle - sin(2 angle)) / (2 angle)^3, and the same of angle.
    third_of_double, third = 1 / 6 - 4 * square * fifth_of_double, 1 / 6 - square * fifth
    own = np.array([[2 * third_of_double, sinc / 2],
                    [sinc / 2, 1 - 2 * third_of_double * square]])
    other = np.array([[2 * (4 * fifth_of_double - fifth), half / 8],
                      [half / 8, 2 * third_of_double]]) * square
    between = np.array([[half / 8, 2 * third_of_double],
                        [2 * third_of_double - third, sinc / 2]]) * angle
    scale = np.array([[dt_s ** 3, dt_s ** 2], [dt_s ** 2, dt_s]])
    return own * scale, other * scale, between * scale


def _sinc(x: float) -> float:
    return sin(x) / x if x else 1.0


def _fifth_remainder(x: float) -> float:
    """Return (sin x - x + x^3 / 6) / x^5, which has a limit at 0."""
    if abs(x) > 2:
        return (sin(x) - x + x ** 3 / 6) / x ** 5
    total = 0.0
    for coefficient in _SERIES:
        total = coefficient - total * x * x
    return total


def image_jacobian(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """
    Return d(u, v)/dt per body rate, (N, 2, 3) in px/rad, of directions (N, 3).

    NaN for a direction behind the camera.
    """
    return image_flows(camera.lens, np.ascontiguousarray(directions))


@compiled
def image_flows(lens: Lens, directions: np.ndarray) -> np.ndarray:
    """Return image_jacobian() of the directions (N, 3)."""
    jacobian = np.full((len(directions), 2, 3), np.nan)
    for star in range(len(directions)):
        a, b = plane_point(lens.equidistant, directions[star, 0], directions[star, 1],
                           directions[star, 2])
        if not np.isnan(a):
            image_flow(lens, a, b, jacobian[star])
    return jacobian


@compiled
def moved_by(lens: Lens, uv: np.ndarray, variance: np.ndarray, rate: np.ndarray,
             rate_covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return state (N, 4) and covariance (N, 4, 4) of stars at uv (N, 2) px, which the body turns.

    variance (N,) px^2 per axis is that of uv; rate (3,) rad/s has a covariance (3, 3).
    """
    state, covariance = np.empty((len(uv), 4)), np.zeros((len(uv), 4, 4))
    flow = image_flows(lens, rays(lens.equidistant, undistorted(lens, uv)))
    for star in range(len(uv)):
        for row in range(2):
            state[star, 2 * row], state[star, 2 * row + 1] = uv[star, row], 0.0
            covariance[star, 2 * row, 2 * row] = variance[star]
            for i in range(3):
                state[star, 2 * row + 1] += flow[star, row, i] * rate[i]
                for column in range(2):
                    for j in range(3):
                        covariance[star, 2 * row + 1, 2 * column + 1] += (
                            flow[star, row, i] * rate_covariance[i, j] * flow[star, column, j])
    return state, covariance


@compiled
def image_flow(lens: Lens, a: float, b: float, jacobian: np.ndarray) -> None:
    """
    Fill the jacobian (2, 3) of image motion per body rate at undistorted coordinates a, b.

    A direction d moves by -e x d where the body turns about an axis e. Then (da, db) is
    (h a b, c + h b2), -(c + h a2, h a b) and (b, -a) for the three axes; c = h = 1 where a, b are
    x / z, y / z, and c = theta cot theta, h = (1 - c) / theta2 for an equidistant lens.
    """
    xx, cross, yy = distortion_jacobian(lens.terms, a, b)
    c = h = 1.0
    if lens.equidistant:
        theta2 = a * a + b * b
        if theta2 > 0:
            theta = np.sqrt(theta2)
            c = theta / np.tan(theta)
            h = (1 - c) / theta2
    for axis in range(3):
        if axis == 0:
            da, db = h * a * b, c + h * b * b
        elif axis == 1:
            da, db = -(c + h * a * a), -h * a * b
        else:
            da, db = b, -a
        jacobian[0, axis] = lens.fx * (xx * da + cross * db)
        jacobian[1, axis] = lens.fy * (cross * da + yy * db)


def turn_curvature(camera: Camera, uv: np.ndarray, rate_rad_s: np.ndarray, dt_s: float
                   ) -> np.ndarray:
    """
    Return what a steady turn adds (N, 4) to a constant velocity prediction of uv (N, 2).

    Stars run on curves across the image, most of all under roll: without this term a
    filter lags behind them. NaN for a star that the turn puts behind the camera.
    """
    return _turn_curvature(camera.lens, np.ascontiguousarray(uv),
                           np.ascontiguousarray(rate_rad_s), dt_s)


@compiled
def _turn_curvature(lens: Lens, uv: np.ndarray, rate_rad_s: np.ndarray, dt_s: float) -> np.ndarray:
    curvature = np.full((len(uv), 4), np.nan)
    flow = np.empty((2, 3))
    R = matrix_from_rotation_vector(rate_rad_s * dt_s)
    for star in range(len(uv)):
        a, b = undistort(lens, (uv[star, 0] - lens.cx) / lens.fx,
                         (uv[star, 1] - lens.cy) / lens.fy)
        x, y, z = ray(lens.equidistant, a, b)
        # R^T d: the direction on the axes after the turn.
        end_a, end_b = plane_point(lens.equidistant, R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
                                   R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
                                   R[0, 2] * x + R[1, 2] * y + R[2, 2] * z)
        if np.isnan(end_a):
            continue
        u, v = distort(lens.terms, end_a, end_b)
        image_flow(lens, a, b, flow)
        start_u, start_v = _times(flow, rate_rad_s)
        image_flow(lens, end_a, end_b, flow)
        end_u, end_v = _times(flow, rate_rad_s)
        curvature[star, 0] = u * lens.fx + lens.cx - uv[star, 0] - start_u * dt_s
        curvature[star, 1] = end_u - start_u
        curvature[star, 2] = v * lens.fy + lens.cy - uv[star, 1] - start_v * dt_s
        curvature[star, 3] = end_v - start_v
    return curvature


@compiled
def _times(flow: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """Return flow (2, 3) times rate (3,)."""
    return (flow[0, 0] * rate[0] + flow[0, 1] * rate[1] + flow[0, 2] * rate[2],
            flow[1, 0] * rate[0] + flow[1, 1] * rate[1] + flow[1, 2] * rate[2])


def body_rate(jacobian: np.ndarray, velocity: np.ndarray, covariance: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the body rate (3,) rad/s that moves stars at velocity (N, 2), and its covariance.

    jacobian (N, 2, 3) as of image_jacobian, covariance (N, 2, 2) of the velocities, positive
    definite; weighted least squares. numpy.linalg.LinAlgError when less than two stars fix it.
    """
    information, vector = normal_equations(
        np.ascontiguousarray(jacobian), np.ascontiguousarray(velocity),
        np.ascontiguousarray(covariance), np.ones(len(jacobian)))
    rate_covariance = np.linalg.inv(information)
    return rate_covariance @ vector, rate_covariance
