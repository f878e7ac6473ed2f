# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Whether a gyro turns the attitude as the stars do.

An attitude that the stars of a frame measured is propagated by the rates alone and compared with
what the stars measure in the frames after. The longer it runs the finer the comparison: after T
seconds a rate that is off by e is seen once e T exceeds the noise of both and the drift allowed.
"""

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.gyro import Gyro
from startracker_ros.core.integrity.checks import GYRO_DIFFERS
from startracker_ros.core.maths.compiled_rotation import rotation_between

LONGEST = 100  # frames, after which the comparison begins anew
AGAIN = 30  # frames that must agree after a contradiction


class GyroAgreement:
    """Compares a gyro with good frames in turn."""

    def __init__(self, gyro: Gyro) -> None:
        self._gyro = gyro
        self._needed = 0
        self.interrupt()

    def interrupt(self) -> None:
        """Begin anew with the next frame."""
        self._reference: AttitudeState | None = None
        self._agreed = self._compared = self._against = 0

    def contradict(self) -> None:
        """Begin anew with a gyro that contradicts the stars."""
        self.interrupt()
        self._needed = AGAIN

    def is_enough(self, frames: int) -> bool:
        """Return whether so many frames agreed, and more after a contradiction."""
        return self._agreed >= max(frames, self._needed)

    def add(self, stamp_ns: int, quaternion: np.ndarray, covariance: np.ndarray,
            drift: np.ndarray, drift_covariance: np.ndarray) -> bool:
        """
        Add the attitude (4,) that the stars of a frame measure, of covariance (3, 3) rad^2.

        drift (3,) rad/s is that of the gyro and its covariance (3, 3), as far as they are known.
        Return whether the gyro contradicts the stars.
        """
        if self._reference is None or self._compared == LONGEST:
            P = np.zeros((9, 9))
            P[:3, :3], P[6:, 6:] = covariance, drift_covariance
            self._reference = AttitudeState(stamp_ns, quaternion, np.zeros(3), drift, P)
            self._compared = 0
            return False
        self._compared += 1
        self._reference, predicted = self._gyro.predict(self._reference, stamp_ns)
        turn = rotation_between(predicted.quaternion, quaternion)
        S = predicted.covariance[:3, :3] + covariance
        if turn @ np.linalg.solve(S, turn) <= GYRO_DIFFERS.threshold:
            self._agreed, self._against = self._agreed + 1, 0
            return False
        self._against += 1
        if self._against < GYRO_DIFFERS.frames:
            return False
        self.contradict()
        return True
