"""How star images move: constant velocity, and the flow under a turn of the camera.

The state of one star is [u, u_rate, v, v_rate] in px and px/s. Under the body rate w
(rad/s, sensor axes) a direction d in the sensor frame changes by -w x d.
"""

import numpy as np

from startracker_ros.camera import Camera
from startracker_ros.rotation import matrix_from_quaternion, quaternion_from_rotation_vector

POSITION = [0, 2]
VELOCITY = [1, 3]


def constant_velocity(dt_s: float, acceleration_px_s2: tuple[float, float]
                      ) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition (4, 4) and process noise (4, 4) of the CV model.

    White acceleration of 1-sigma (u, v), constant within the step: Q = E diag(s^2) E^T
    (Sadeghi, Sabahi and Saberali).
    """
    transition = np.eye(4)
    transition[0, 1] = transition[2, 3] = dt_s
    noise = np.zeros((4, 2))
    noise[[0, 2], [0, 1]] = dt_s * dt_s / 2 * np.asarray(acceleration_px_s2)
    noise[[1, 3], [0, 1]] = dt_s * np.asarray(acceleration_px_s2)
    return transition, noise @ noise.T


def image_jacobian(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """Return d(u, v)/dt per body rate, (N, 2, 3) in px/rad, of directions (N, 3)."""
    step_rad = 1e-5
    # Row k is -e_k x d; central differences see the distortion as the camera models it.
    turned = step_rad * np.cross(directions, np.eye(3)[:, None])
    ahead, behind = camera.project(np.stack([directions + turned, directions - turned]))
    return np.moveaxis((ahead - behind) / (2 * step_rad), 0, -1)


def turn_curvature(camera: Camera, uv: np.ndarray, rate_rad_s: np.ndarray, dt_s: float
                   ) -> np.ndarray:
    """Return what a steady turn adds (N, 4) to a constant velocity prediction of uv (N, 2).

    Stars run on curves across the image, most of all under roll: without this term a
    filter lags behind them.
    """
    start = camera.unproject(uv)
    # Row vectors times R are R^T d: the direction after the turn, on the new axes.
    end = start @ matrix_from_quaternion(quaternion_from_rotation_vector(rate_rad_s * dt_s))
    flow = image_jacobian(camera, np.concatenate([start, end])) @ rate_rad_s
    flow_start, flow_end = flow[:len(uv)], flow[len(uv):]
    curvature = np.empty((len(uv), 4))
    curvature[:, POSITION] = camera.project(end) - uv - flow_start * dt_s
    curvature[:, VELOCITY] = flow_end - flow_start
    return curvature


def body_rate(jacobian: np.ndarray, velocity: np.ndarray, covariance: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the body rate (3,) rad/s that moves stars at velocity (N, 2), and its covariance.

    jacobian (N, 2, 3) as of image_jacobian, covariance (N, 2, 2) of the velocities;
    weighted least squares.
    """
    weighted = np.swapaxes(jacobian, 1, 2) @ np.linalg.inv(covariance)
    rate_covariance = np.linalg.inv(np.sum(weighted @ jacobian, axis=0))
    return rate_covariance @ np.einsum('nij,nj->i', weighted, velocity), rate_covariance
