"""
Attitude, rate and gyro bias from all frames of a recording, before and after each.

A multiplicative Kalman filter forward and the recursion of Rauch, Tung and Striebel (AIAA J. 3,
1965) backward; Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and
Control, 6.2. The attitudes of single frames are the measurements: their errors are independent.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.maths.rotation import (
    attitude_error, matrix_from_quaternion, multiply, quaternion_from_rotation_vector)


@dataclass(frozen=True)
class MotionNoise:
    """
    How the body moves between two frames.

    With a gyro: noise_density (rad^2/s) of its white noise, drift_density (rad^2/s^3) of its bias
    and drift_sigma_rad_s of that bias at the begin. Without: acceleration_density (3,) rad^2/s^3
    of a rate that is constant but for white acceleration.
    """

    noise_density: float
    drift_density: float
    drift_sigma_rad_s: float
    acceleration_density: np.ndarray


@dataclass(frozen=True)
class SmoothedAttitude:
    """
    At each frame (N,): quaternion (N, 4), rate_rad_s and bias_rad_s (N, 3), covariance (N, 6, 6).

    The covariance is that of the attitude error about sensor axes and, with a gyro, of the bias,
    otherwise of the rate. bias is zero without a gyro.
    """

    quaternion: np.ndarray
    rate_rad_s: np.ndarray
    bias_rad_s: np.ndarray
    covariance: np.ndarray


_RATE_SIGMA_RAD_S = np.radians(10.0)
_ATTITUDE_SIGMA_RAD = np.radians(10.0)


def smooth(stamp_ns: np.ndarray, measured: np.ndarray, covariance: np.ndarray,
           noise: MotionNoise, gyro_rad_s: np.ndarray | None = None) -> SmoothedAttitude:
    """
    Return the smoothed attitude of frames (N,), ascending, the first of which is measured.

    measured (N, 4) has NaN where a frame has no attitude; covariance (N, 3, 3) rad^2 is about
    sensor axes. gyro_rad_s (N, 3) is the mean rate since the frame before, None without a gyro.
    """
    count = len(stamp_ns)
    filtered = [_State(measured[0], np.zeros(3), np.diag(np.repeat(
        [_ATTITUDE_SIGMA_RAD ** 2, (noise.drift_sigma_rad_s if gyro_rad_s is not None
                                    else _RATE_SIGMA_RAD_S) ** 2], 3)))]
    filtered[0] = filtered[0].updated(measured[0], covariance[0])
    predicted, transitions = [filtered[0]], [np.eye(6)]
    for k in range(1, count):
        dt_s = (stamp_ns[k] - stamp_ns[k - 1]) * 1e-9
        state, transition = filtered[-1].propagated(
            dt_s, noise, None if gyro_rad_s is None else gyro_rad_s[k])
        predicted.append(state)
        transitions.append(transition)
        if np.isfinite(measured[k, 0]):
            state = state.updated(measured[k], covariance[k])
        filtered.append(state)
    smoothed = [filtered[-1]]
    for k in range(count - 2, -1, -1):
        smoothed.append(filtered[k].corrected(transitions[k + 1], predicted[k + 1],
                                              smoothed[-1]))
    smoothed.reverse()
    second = np.array([state.second for state in smoothed])
    if gyro_rad_s is None:
        rate, bias = second, np.zeros((count, 3))
    else:
        rate, bias = gyro_rad_s - second, second
    return SmoothedAttitude(np.array([state.quaternion for state in smoothed]), rate, bias,
                            np.array([state.covariance for state in smoothed]))


@dataclass(frozen=True)
class _State:
    """Attitude (4,), second (3,), the gyro bias or the rate, and their covariance (6, 6)."""

    quaternion: np.ndarray
    second: np.ndarray
    covariance: np.ndarray

    def propagated(self, dt_s: float, noise: MotionNoise, gyro_rad_s: np.ndarray | None
                   ) -> tuple['_State', np.ndarray]:
        """Return the state after dt_s, and the transition (6, 6) of its error."""
        rate = self.second if gyro_rad_s is None else gyro_rad_s - self.second
        turn = quaternion_from_rotation_vector(rate * dt_s)
        transition = np.eye(6)
        transition[:3, :3] = matrix_from_quaternion(turn).T
        transition[:3, 3:] = np.eye(3) * (dt_s if gyro_rad_s is None else -dt_s)
        added = np.zeros((6, 6))
        if gyro_rad_s is None:
            density = np.diag(noise.acceleration_density)
            added[:3, :3], added[3:, 3:] = density * dt_s ** 3 / 3, density * dt_s
            added[:3, 3:] = added[3:, :3] = density * dt_s ** 2 / 2
        else:
            drift = noise.drift_density * np.eye(3)
            added[:3, :3] = np.eye(3) * noise.noise_density * dt_s + drift * dt_s ** 3 / 3
            added[:3, 3:] = added[3:, :3] = -drift * dt_s ** 2 / 2
            added[3:, 3:] = drift * dt_s
        return _State(multiply(self.quaternion, turn), self.second,
                      transition @ self.covariance @ transition.T + added), transition

    def updated(self, measured: np.ndarray, covariance: np.ndarray) -> '_State':
        """Return the state updated by an attitude (4,) with its covariance (3, 3)."""
        gain = np.linalg.solve(self.covariance[:3, :3] + covariance, self.covariance[:3]).T
        after = self.covariance - gain @ self.covariance[:3]
        return self.moved(gain @ attitude_error(measured, self.quaternion),
                          (after + after.T) / 2)

    def moved(self, change: np.ndarray, covariance: np.ndarray) -> '_State':
        """Return the state with its error (6,) corrected, and this covariance."""
        q = multiply(self.quaternion, quaternion_from_rotation_vector(change[:3]))
        return _State(q / np.sqrt(q @ q), self.second + change[3:], covariance)

    def corrected(self, transition: np.ndarray, predicted: '_State', after: '_State') -> '_State':
        """C = P Phi^T (P-)^-1; x + C (x_s - x-), P + C (P_s - P-) C^T."""
        C = np.linalg.solve(predicted.covariance, transition @ self.covariance).T
        difference = np.concatenate([
            attitude_error(after.quaternion, predicted.quaternion),
            after.second - predicted.second])
        covariance = self.covariance + C @ (after.covariance - predicted.covariance) @ C.T
        return self.moved(C @ difference, (covariance + covariance.T) / 2)
