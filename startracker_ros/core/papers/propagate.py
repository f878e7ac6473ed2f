# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude between two frames, propagated by gyro rates, with its covariance."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.core.maths.rotation import attitude_error


@dataclass(frozen=True)
class AttitudePrediction:
    """
    A propagated attitude.

    quaternion (4,) is q_icrf_from_sensor; covariance_sensor (3, 3) rad^2 that of
    rotation.attitude_error, a rotation vector about sensor axes.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray


class AttitudePropagator:
    """
    Attitude and gyro drift, propagated by gyro rates and updated by attitudes of frames.

    A prediction beyond the newest rate does not harm the next one: rates that come late, as
    those of a stopped process do, are used then.
    """

    def __init__(self, options: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._gyro = Gyro(options)
        # That of the newest rate, and that of the last prediction.
        self._state: AttitudeState | None = None
        self._predicted: AttitudeState | None = None

    @property
    def has_rates(self) -> bool:
        """Whether any rate was measured so far."""
        return len(self._gyro) > 0

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Add a rate as Gyro.add does."""
        return self._gyro.add(stamp_ns, rate_rad_s)

    def start(self, stamp_ns: int, quaternion: np.ndarray,
              covariance_sensor: np.ndarray) -> None:
        """Begin with an attitude and an unknown drift."""
        covariance = np.zeros((9, 9))
        covariance[:3, :3] = covariance_sensor
        self._state = AttitudeState(
            stamp_ns, quaternion, np.zeros(3), np.zeros(3), covariance).with_new_drift(
            self._gyro.drift_sigma_rad_s)

    def predict(self, stamp_ns: int) -> AttitudePrediction | None:
        """Return the attitude at a time, None before the first one or without any rate."""
        if self._state is None or stamp_ns < self._state.stamp_ns or not self.has_rates:
            return None
        self._state, self._predicted = self._gyro.predict(self._state, stamp_ns)
        return AttitudePrediction(self._predicted.quaternion, self._predicted.covariance[:3, :3])

    def correct(self, quaternion: np.ndarray, covariance_sensor: np.ndarray) -> None:
        """Update by the attitude of a frame at the time of the last prediction, if any."""
        if self._predicted is None:
            return
        information = np.linalg.inv(covariance_sensor)
        innovation = attitude_error(quaternion, self._predicted.quaternion)
        self._state = self._predicted.with_attitude(information, information @ innovation)
