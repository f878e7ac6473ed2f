# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the body moves from one frame to the next: by its modes of motion, the gyro, or both."""

import math

import numpy as np
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions, rate_text
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.fusion.state import BODY, FusedState, GATE, Measurement
from startracker_ros.core.integrity.checks import GYRO_AT_RANGE, GYRO_SILENT, MOTION_ENDS
from startracker_ros.core.integrity.gyro_agreement import GyroAgreement
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.track.motion_filter import (
    by_experience, Motion, predicted, restarted, STEADY, weight_of)

GYRO_FRAMES = 3  # with whose rate a gyro has to agree before it is used
GYRO_SILENCE_S = GYRO_SILENT.limits['age_s']
_ACCELERATION_S = 0.1
_SHARP_TURN_RAD = 5 * ARCSEC  # 1 sigma, beyond the newest rate


class BodyMotion:
    """
    Propagates states; uses the gyro once it has agreed with the rate of the heads.

    walk (M,) rad^2/s are the spectral densities of the coefficients of the mounts. gyro_trouble
    is why the rates of a gyro are not used, empty where they are or without one.
    """

    def __init__(self, options: FusionOptions, gyro_options: GyroErrorOptions,
                 walk: np.ndarray) -> None:
        self._options = options
        self._gyro_options = gyro_options
        # Of drift and coefficients.
        self._walk = np.concatenate([np.full(3, Gyro(gyro_options).drift_density), walk])
        self.reset()

    def reset(self) -> None:
        """Forget the rates."""
        self.gyro_trouble = ''
        self._begin_gyro()

    def _begin_gyro(self) -> None:
        """Begin with a gyro of which nothing is known."""
        self._gyro = Gyro(self._gyro_options)
        self.uses_gyro = False
        self._agreements: dict[str, GyroAgreement] = {}

    def forget_gyro(self) -> None:
        """Use the gyro only after it has agreed with the heads anew."""
        self.uses_gyro = False
        for one in self._agreements.values():
            one.interrupt()

    @property
    def drift_sigma_rad_s(self) -> float:
        """Return the 1-sigma error of a drift of which nothing is known."""
        return self._gyro.drift_sigma_rad_s

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """
        Add a rate (3,) about body axes; False if it is rejected or not newer than the last.

        A jump of time back by more than a second is another gyro.
        """
        silent_s = self._gyro.silent_s(stamp_ns)
        if silent_s <= 0:
            if silent_s > -GYRO_SILENCE_S:
                return False
            self._begin_gyro()
        added = self._gyro.add(stamp_ns, rate_rad_s)
        if self._gyro.saturated_ns == stamp_ns:
            self.forget_gyro()
            self.gyro_trouble = GYRO_AT_RANGE.diagnostic
        return added

    def gyro_runs(self, stamp_ns: int) -> bool:
        """Return whether the rates propagate a state to a time."""
        ahead_s = self._options.horizon_s + GYRO_SILENCE_S
        return self.uses_gyro and -ahead_s <= self._gyro.silent_s(stamp_ns) <= GYRO_SILENCE_S

    def extrapolates(self, stamp_ns: int) -> bool:
        """
        Return whether the rates end so long before a time that they predict nothing sharp.

        A state predicted so would take any frame of that time for right.
        """
        return self.gyro_runs(stamp_ns) and self._is_behind(stamp_ns)

    def _is_behind(self, stamp_ns: int) -> bool:
        silent_s = max(0.0, self._gyro.silent_s(stamp_ns))
        turned_rad = math.radians(self._gyro_options.gyro_rate_change_deg_s2) * silent_s ** 2
        return turned_rad > _SHARP_TURN_RAD

    def bridged_s(self, stamp_ns: int) -> float:
        """Return the longest time without frames before a time."""
        return (self._options.max_gyro_gap_s if self.gyro_runs(stamp_ns)
                else self._options.max_gap_s)

    def propagated(self, state: FusedState, to_ns: int) -> FusedState:
        """
        Return a state at a later time, by what the body has been seen to do.

        A motion that begins is not expected: it is what frames that disagree are checked for.
        """
        if not self.gyro_runs(to_ns):
            return self.without_gyro(state, to_ns)
        gyro, before = self._gyro, state.motion
        if (to_ns - state.stamp_ns) * 1e-9 <= self._options.max_gap_s:
            motion = self._predicted(before, to_ns, 1.0, *gyro.rates(state.stamp_ns, to_ns))
            if motion.weight[np.argmax(before.weight)] > MOTION_ENDS.probability:
                return _by_experience(motion)
        # Of another motion than before the modes know less than the gyro, which integrates it.
        body = gyro.propagate(state.body, to_ns)
        mounts = np.arange(BODY, len(body.covariance))
        body.covariance[mounts, mounts] += self._walk[3:] * ((to_ns - state.stamp_ns) * 1e-9)
        return _by_experience(restarted(before, body))

    def without_gyro(self, state: FusedState, to_ns: int) -> FusedState:
        """Return the same without the gyro."""
        return _by_experience(self._predicted(state.motion, to_ns, 1.0))

    def at_constant_rate(self, state: FusedState, to_ns: int, factor: float) -> FusedState:
        """Return it at a constant rate, with a factor of the acceleration of the options."""
        motion = self._predicted(state.motion, to_ns, factor)
        return FusedState.of(motion, weight_of(motion, np.array([STEADY])))

    def _predicted(self, motion: Motion, to_ns: int, factor: float,
                   dt_s: np.ndarray | None = None, rates: np.ndarray = np.empty((0, 3)),
                   variances: np.ndarray = np.empty(0)) -> Motion:
        """Return a motion at a later time, by rates of the gyro as Gyro.rates() has them."""
        if dt_s is None:
            dt_s = np.array([(to_ns - motion.stamp_ns) * 1e-9])
        # As large in its effect as one that lasts for _ACCELERATION_S.
        acceleration = factor * math.radians(self._options.acceleration_deg_s2) * math.sqrt(
            _ACCELERATION_S / motion.interval_s)
        return predicted(
            motion, to_ns, dt_s, rates, variances, np.full(3, acceleration), self._walk)

    def contradict_gyro(self, trouble: str) -> None:
        """Let the gyro agree with the heads for longer before it is used again."""
        self.gyro_trouble = trouble
        for one in self._agreements.values():
            one.contradict()

    def compare_gyro(self, name: str, before: FusedState, after: FusedState,
                     measured: Measurement) -> bool:
        """
        Compare the gyro with the heads after a frame of a head, which measures the body.

        Return whether it is used no more: the rate of the state after is a wrong one then.
        """
        gyro, agreement = self._gyro, self._agreements.setdefault(name, GyroAgreement(self._gyro))
        if after.stamp_ns <= before.stamp_ns:
            return False
        if (abs(gyro.silent_s(after.stamp_ns)) > GYRO_SILENCE_S
                or gyro.is_saturated(after.stamp_ns, GYRO_SILENCE_S)):
            agreement.interrupt()
            return False
        if self._is_behind(after.stamp_ns):
            agreement.interrupt()
            if not self.uses_gyro:
                silent_s = gyro.silent_s(after.stamp_ns)
                self.gyro_trouble = f'imu is {silent_s:.2g} s behind the heads'
            return False
        contradicts = agreement.add(
            after.stamp_ns, measured.quaternion, measured.covariance, after.drift,
            after.covariance[6:BODY, 6:BODY])
        if self.uses_gyro and not contradicts:
            return False
        rate, variance = gyro.mean_rate(before.stamp_ns, after.stamp_ns)
        reported = f'imu reports {rate_text(rate)} deg/s about x, y, z of the body, '
        if contradicts:
            self.contradict_gyro(reported + (
                f'{name} does not turn so: is it in rad/s, on the axes of the body, and '
                'gyro_drift_deg_h right?'))
        if self.uses_gyro:
            self.uses_gyro = False
            return True
        innovation = rate - after.rate
        S = after.covariance[3:6, 3:6] + np.eye(3) * (variance + gyro.drift_sigma_rad_s ** 2)
        if innovation @ np.linalg.solve(S, innovation) > GATE:
            self.forget_gyro()
            self.gyro_trouble = reported + f'the heads {rate_text(after.rate)}'
        elif agreement.is_enough(GYRO_FRAMES):
            self.uses_gyro, self.gyro_trouble = True, ''
        return False


def _by_experience(motion: Motion) -> FusedState:
    return FusedState.of(motion, by_experience(motion.weight, motion.share))
