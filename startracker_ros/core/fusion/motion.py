# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the body moves from one frame to the next: by the gyro, at a constant rate, or both."""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import Prediction
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions, rate_text
from startracker_ros.core.compiled import compiled
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.fusion.state import BODY, FusedState, GATE, Innovation, Measurement
from startracker_ros.core.integrity.checks import GYRO_AT_RANGE, GYRO_SILENT
from startracker_ros.core.integrity.gyro_agreement import GyroAgreement
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.maths.small_algebra import inverse

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
        self._walk = walk
        self._density = math.radians(options.acceleration_deg_s2) ** 2 * _ACCELERATION_S
        self._level = MotionLevel()
        self.reset()

    def reset(self) -> None:
        """Forget the rates."""
        self._level.reset()
        self._newest: tuple[FusedState, int, Prediction | None] | None = None
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
        self._newest = None
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

    def propagated(self, state: FusedState, to_ns: int, factor: float) -> FusedState:
        """Return a state at a later time; factor is that of the acceleration without a gyro."""
        if not self.gyro_runs(to_ns):
            return self.at_constant_rate(state, to_ns, factor)
        filtered, gyro = self._filtered(state, to_ns), self._gyro
        if filtered is not None:
            return state.after(filtered, self._walk)
        return state.at_gyro_rate(
            gyro.steps(state.stamp_ns, to_ns), gyro.drift_density, self._walk)

    def _filtered(self, state: FusedState, to_ns: int) -> Prediction | None:
        """
        Return the body at a constant rate, updated by the gyro; None if it turns in another way.

        What the heads show of a smooth motion is more than a noisy gyro knows.
        """
        # A frame is predicted, and then corrected by the same prediction.
        if self._newest is None or self._newest[0] is not state or self._newest[1] != to_ns:
            self._newest = state, to_ns, self._filter(state, to_ns)
        return self._newest[2]

    def _filter(self, state: FusedState, to_ns: int) -> Prediction | None:
        body, density = state.body, self._level.level * self._density
        # The mean rate of an interval dt changes by density dt / 3, a mean acceleration a by
        # a dt / 2.
        variance = density * 4 / 3 / max((to_ns - state.stamp_ns) * 1e-9, 1e-9)
        if not self._gyro.expects(body, to_ns, np.zeros(3), np.full(3, variance)):
            return None
        return self._gyro.filtered(body, to_ns, np.zeros(3), np.full(3, density))

    def at_constant_rate(self, state: FusedState, to_ns: int, factor: float) -> FusedState:
        """Return the same without the gyro."""
        return state.at_constant_rate(to_ns, factor ** 2 * self._level.level * self._density,
                                      self._gyro.drift_density, self._walk)

    def started(self) -> None:
        """Know nothing of the motion until the heads show it."""
        self._level.doubt()

    def learnt(self, before: FusedState, predicted: FusedState, innovation: Innovation,
               corrected: FusedState, factor: float) -> FusedState:
        """Return a corrected state by what its frame says of how the rate changes."""
        stamp_ns, prediction = predicted.stamp_ns, None
        if factor == 1 and self.gyro_runs(stamp_ns):
            prediction = self._filtered(before, stamp_ns)
        elif factor == 1:
            prediction = before.body.predicted_at_constant_rate(
                stamp_ns, np.full(3, self._level.level * self._density), 0.0)
        if prediction is None:
            self._level.interrupt()
            return corrected
        return self._level.add(prediction, predicted, innovation, corrected)

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


# --- how much the rate of a body changes, by the innovations of the heads ---
#
# The gain of the filter is that of an assumed process noise, so that it follows motions which
# begin. Of a body that turns steadily its covariance is too large by that noise, under an
# acceleration that no frame shows it is too small. With the gain K as it is and A = I - K H
# = P P-^-1, the part P_Q of the covariance P by the process noise Q is
#
#     P_Q- = Phi P_Q Phi^T + Q,  P_Q = A P_Q- A^T,
#
# and with k times the process noise the errors have the covariance P + (k - 1) P_Q. The
# innovations z of covariance S tell k. The change of the estimate with the logarithm of the noise
# is
#
#     d- = Phi d,  d = A d- + P_Q H^T R^-1 z,
#
# for P_Q is the derivative of P. The score, the derivative of the logarithm of the likelihood, is
# about each axis s = (P_Q- / S) (z^2 / S - 1) / 2 + z d- / S, and its mean (k - 1) i, with the
# Fisher information i = (P_Q- / S)^2 / 2 + D- / S and D the covariance of d at k = 1: so k is
# unbiased, however far from 1 it is. The second term compares innovations in a row, which tell
# more of a small k than the first.
#
# The process noise is level times the assumed one. With P_Q the part of the covariance by it, the
# score tells by how much it is off: where the sum of the scores of the frames so far is beyond
# SURE standard deviations, the level is k times as large, and so is P_Q.

MEMORY = 0.985  # of the frames before
ASSUMED = 0.3
"""Fisher information of the assumption that k is 1, before the first frame: 1.8 at 1 sigma."""
SURE = 2.0
FIRST = 100.0  # of a body of which no frame has shown how it moves
MOST, LEAST = 100.0, 0.2  # times as large at once
HIGHEST = 1e8  # of the level, beyond which nothing is predicted


class Memory(NamedTuple):
    """
    What is known of the frames before; the arrays are changed in place.

    share (9, 9) is P_Q, spread (9, 9) D and change (9,) d; score (3,) and information (3,) are
    sums of s and i about sensor axes.
    """

    share: np.ndarray
    spread: np.ndarray
    change: np.ndarray
    score: np.ndarray
    information: np.ndarray

    @classmethod
    def empty(cls) -> 'Memory':
        """Return that before the first frame."""
        return cls(np.zeros((9, 9)), np.zeros((9, 9)), np.zeros(9), np.zeros(3), np.zeros(3))


class MotionLevel:
    """Learns level, 1 or more, by frames in turn that no gyro alone predicts."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Assume the process noise that the options state."""
        self.level = 1.0
        self._memory = Memory.empty()

    def doubt(self) -> None:
        """Know nothing of how the body moves until its frames show it."""
        self.interrupt()
        self.level = max(self.level, FIRST)

    def interrupt(self) -> None:
        """Take all of the covariance as known: what comes next is predicted in another way."""
        for array in self._memory:
            array.fill(0.0)

    def add(self, prediction: Prediction, predicted: FusedState, innovation: Innovation,
            corrected: FusedState) -> FusedState:
        """
        Add the prediction of the body in a frame and its correction; return the latter.

        Where the level changes, so does the covariance of the state.
        """
        memory, P = self._memory, np.ascontiguousarray(predicted.covariance[:BODY, :BODY])
        add_frame(memory, prediction.transition, prediction.process, P,
                  np.ascontiguousarray(corrected.covariance[:BODY, :BODY]), innovation.vector,
                  np.linalg.inv(innovation.information) - P[:3, :3])
        score, information = memory.score.sum(), memory.information.sum()
        if abs(score) <= SURE * np.sqrt(information):
            return corrected
        k = min(max(1 + score / (information + ASSUMED), LEAST, 1 / self.level), MOST,
                HIGHEST / self.level)
        if k == 1:
            return corrected
        self.level *= k
        covariance = corrected.covariance.copy()
        covariance[:BODY, :BODY] += (k - 1) * memory.share
        memory.share[:] *= k
        for array in memory[1:]:
            array.fill(0.0)
        return corrected._replace(covariance=covariance)


@compiled
def add_frame(memory: Memory, transition: np.ndarray, process: np.ndarray, P: np.ndarray,
              corrected: np.ndarray, turn: np.ndarray, R: np.ndarray) -> None:
    """Add a frame to the memory: Phi, Q, and the covariance P of the prediction."""
    share, spread, change, score, information = memory
    share[:] = transition @ share @ transition.T + process
    spread[:] = transition @ spread @ transition.T
    change[:] = transition @ change
    S = P[:3, :3] + R
    for axis in range(3):
        part, normalised = share[axis, axis] / S[axis, axis], turn[axis] ** 2 / S[axis, axis]
        score[axis] = MEMORY * score[axis] + (
            part * (normalised - 1) / 2 + turn[axis] * change[axis] / S[axis, axis])
        information[axis] = MEMORY * information[axis] + (
            part ** 2 / 2 + spread[axis, axis] / S[axis, axis])
    A = np.linalg.solve(P, corrected).T
    share[:] = A @ share @ A.T
    G = np.ascontiguousarray(share[:, :3]) @ inverse(R)
    change[:] = A @ change + G @ turn
    spread[:] = A @ spread @ A.T + G @ S @ G.T
