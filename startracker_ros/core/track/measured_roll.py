"""The roll of an image about its principal point that a gyro has measured."""

from math import cos, sin

import numpy as np
from startracker_ros.core.camera.model import Camera


def rolled(camera: Camera, rate_rad_s: float, dt_s: float) -> np.ndarray:
    """
    Return the transition (4, 4) of a star, as seen from the principal point, by a known roll.

    Position and velocity turn by rate_rad_s dt_s (body rate z), and the velocity gains that of the
    image under rate_rad_s. With F of the motion without the roll the state becomes
    rolled(rate, dt) F rolled(-rate before, 0) X: equation 18 of Sadeghi, Sabahi and Saberali.
    """
    aspect = camera.fx / camera.fy
    sine, cosine = sin(rate_rad_s * dt_s), cos(rate_rad_s * dt_s)
    turn = np.array([[cosine, sine * aspect], [-sine / aspect, cosine]])
    flow = rate_rad_s * np.array([[0.0, aspect], [-1 / aspect, 0.0]])
    return np.kron(turn, np.eye(2)) + np.kron(flow @ turn, [[0.0, 0.0], [1.0, 0.0]])
