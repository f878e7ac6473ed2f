"""The attitude between two frames, carried on by a gyro, and how sure it still is."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from startracker_ros.options import option, Options
from startracker_ros.rotation import (
    attitude_error, matrix_from_quaternion, multiply, quaternion_from_rotation_vector)

_DEG_H = np.radians(1 / 3600)
_DEG_SQRT_H = np.radians(1 / 60)
_HOUR_S = 3600.0

MAX_RATE_RAD_S = np.radians(100.0)
"""No gyro of a spacecraft that sees stars means this: such a measurement is left out."""

_MAX_MEASUREMENTS = 100_000


@dataclass(frozen=True)
class GyroErrorOptions(Options):
    """What the measured rates may be off by; too small figures lose the stars after a pause."""

    gyro_drift_deg_h: float = option(
        3.0, 'constant drift of the gyro, 1 sigma of each axis; it is estimated, and may change '
        'by as much in an hour', unit='deg/h', low=0.001, high=10000.0)
    gyro_noise_deg_sqrt_h: float = option(
        0.15, 'white noise of the gyro (angle random walk), each axis', unit='deg/sqrt(h)',
        low=0.0, high=100.0)
    gyro_rate_change_deg_s2: float = option(
        0.1, 'how fast the body may change its rate between measurements, 1 sigma of each axis: '
        'what a gap in imu costs', unit='deg/s^2', low=0.0, high=1000.0)


@dataclass(frozen=True)
class AttitudePrediction:
    """An attitude that no star was asked for.

    quaternion (4,) is q_icrf_from_sensor; covariance_sensor (3, 3) rad^2 that of
    rotation.attitude_error, a rotation vector about sensor axes.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray


class AttitudePropagator:
    """Attitude and gyro drift, predicted by rates and corrected by the attitudes of frames.

    The multiplicative Kalman filter of Lefferts, Markley and Shuster (J. Guid. Control 5,
    1982) with the gyro model of Farrenkopf (1978). Its state is the error about sensor
    axes, [attitude (3,) rad, drift (3,) rad/s]. A measured rate is the mean over the time
    since the measurement before, so it is used back to that one; where there is none, the
    nearest one stands in, and the uncertainty grows with the distance in time.
    """

    def __init__(self, options: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._drift_sigma = options.gyro_drift_deg_h * _DEG_H
        self._noise_density = (options.gyro_noise_deg_sqrt_h * _DEG_SQRT_H) ** 2
        self._rate_change = np.radians(options.gyro_rate_change_deg_s2)
        self._rates: deque[tuple[int, np.ndarray]] = deque(maxlen=_MAX_MEASUREMENTS)
        self._last: tuple[int, np.ndarray] | None = None
        self.forget_attitude()

    def forget_attitude(self) -> None:
        """Predict nothing until the next start."""
        self._quaternion: np.ndarray | None = None

    @property
    def has_rates(self) -> bool:
        """Whether any rate was measured so far."""
        return self._last is not None or bool(self._rates)

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Take the rate (3,) about sensor axes measured up to a time; False if it is unusable.

        Measurements come in the order of their stamps.
        """
        rate = np.asarray(rate_rad_s, float)
        if not np.isfinite(rate).all() or np.abs(rate).max() > MAX_RATE_RAD_S:
            return False
        self._rates.append((stamp_ns, rate))
        return True

    def start(self, stamp_ns: int, quaternion: np.ndarray,
              covariance_sensor: np.ndarray) -> None:
        """Begin with an attitude; the drift is unknown again."""
        self._stamp_ns, self._quaternion = stamp_ns, quaternion
        self._drift = np.zeros(3)
        self._covariance = np.zeros((6, 6))
        self._covariance[:3, :3] = covariance_sensor
        self._covariance[3:, 3:] = np.eye(3) * self._drift_sigma ** 2

    def predict(self, stamp_ns: int) -> AttitudePrediction | None:
        """Return the attitude at a time, None before the first one or without any rate."""
        while self._rates and self._rates[0][0] <= stamp_ns:
            self._last = self._rates.popleft()
            self._advance(*self._last, self._last[0])
        if self._quaternion is None or stamp_ns < self._stamp_ns or not self.has_rates:
            return None
        measured_ns, rate = self._rates[0] if self._rates else self._last
        self._advance(measured_ns, rate, stamp_ns)
        return AttitudePrediction(self._quaternion, self._covariance[:3, :3])

    def correct(self, quaternion: np.ndarray, covariance_sensor: np.ndarray) -> None:
        """Take the attitude of a frame at the time of the last prediction."""
        gain = self._covariance[:, :3] @ np.linalg.inv(
            self._covariance[:3, :3] + covariance_sensor)
        change = -gain @ attitude_error(self._quaternion, quaternion)
        self._turn(change[:3])
        self._drift = self._drift + change[3:]
        self._covariance = self._covariance - gain @ self._covariance[:3]
        self._covariance = (self._covariance + self._covariance.T) / 2

    def _advance(self, measured_ns: int, rate: np.ndarray, to_ns: int) -> None:
        """Go on to a time with one measured rate."""
        if self._quaternion is None or to_ns <= self._stamp_ns:
            return
        dt_s = (to_ns - self._stamp_ns) * 1e-9
        away_s = max(abs(measured_ns - self._stamp_ns), abs(measured_ns - to_ns)) * 1e-9
        turn = (rate - self._drift) * dt_s
        transition = np.eye(6)
        transition[:3, :3] = matrix_from_quaternion(quaternion_from_rotation_vector(-turn))
        transition[:3, 3:] = -dt_s * np.eye(3)
        self._covariance = transition @ self._covariance @ transition.T
        attitude_variance = (self._noise_density * dt_s
                             + (self._rate_change * away_s * dt_s) ** 2)
        drift_variance = self._drift_sigma ** 2 * dt_s / _HOUR_S
        self._covariance[np.diag_indices(6)] += np.repeat(
            [attitude_variance, drift_variance], 3)
        self._turn(turn)
        self._stamp_ns = to_ns

    def _turn(self, rotation: np.ndarray) -> None:
        quaternion = multiply(self._quaternion, quaternion_from_rotation_vector(rotation))
        self._quaternion = quaternion / np.linalg.norm(quaternion)
