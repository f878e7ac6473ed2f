# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How large the process noise is, over the one that the filter assumes.

The gain of the filter is that of an assumed process noise, so that it follows motions which begin.
Of a body that turns steadily its covariance is too large by that noise, under an acceleration that
no frame shows it is too small. With the gain K as it is and A = I - K H = P P-^-1, the part P_Q of
the covariance P by the process noise Q is

    P_Q- = Phi P_Q Phi^T + Q,  P_Q = A P_Q- A^T,

and with k times the process noise the errors have the covariance P + (k - 1) P_Q. The innovations
z of covariance S tell k. The change of the estimate with the logarithm of the noise is

    d- = Phi d,  d = A d- + P_Q H^T R^-1 z,

for P_Q is the derivative of P. The score, the derivative of the logarithm of the likelihood, is
about each axis s = (P_Q- / S) (z^2 / S - 1) / 2 + z d- / S, and its mean (k - 1) i, with the
Fisher information i = (P_Q- / S)^2 / 2 + D- / S and D the covariance of d at k = 1: so k is
unbiased, however far from 1 it is. The second term compares innovations in a row, which tell more
of a small k than the first.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import Prediction
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.small_algebra import inverse

MEMORY = 0.985  # of the frames before
ASSUMED = 0.3
"""Fisher information of the assumption that k is 1, before the first frame: 1.8 at 1 sigma."""


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


class ProcessNoise:
    """
    Learns k about each sensor axis by good frames in turn.

    excess is (k - 1) P_Q (6, 6), by which the covariance of attitude and rate is too small.
    """

    def __init__(self) -> None:
        self._memory = Memory.empty()
        self.excess = np.zeros((6, 6))

    def interrupt(self) -> None:
        """Take all of the covariance as known: what is predicted next is no steady motion."""
        for array in self._memory[:3]:
            array.fill(0.0)
        self.excess = np.zeros((6, 6))

    def add(self, prediction: Prediction, covariance: np.ndarray, corrected: np.ndarray,
            turn: np.ndarray, turn_covariance: np.ndarray) -> None:
        """
        Add a frame whose prediction has this covariance (9, 9), with the errors of all stars.

        corrected (9, 9) is the one after the frame; turn (3,) rad, of covariance (3, 3), is what
        the stars measure from the prediction.
        """
        add_frame(self._memory, prediction.transition, prediction.process, covariance, corrected,
                  turn, turn_covariance)
        size = np.sqrt(np.tile(self.ratio, 2))
        self.excess = self._memory.share[:6, :6] * (size[:, None] * size - 1)

    @property
    def ratio(self) -> np.ndarray:
        """Return k (3,) about sensor axes."""
        memory = self._memory
        return np.maximum(1 + memory.score / (memory.information + ASSUMED), 0.0)


@compiled
def add_frame(memory: Memory, transition: np.ndarray, process: np.ndarray, P: np.ndarray,
              corrected: np.ndarray, turn: np.ndarray, R: np.ndarray) -> None:
    """Add a frame as of ProcessNoise.add(); transition is Phi, process Q."""
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
