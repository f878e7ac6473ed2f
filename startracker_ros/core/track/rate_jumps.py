# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Jumps of the body rate that the filter of attitude and rate has not followed yet.

The generalised likelihood ratio of Willsky and Jones (IEEE Trans. Autom. Control 21, 1976), with
a prior of the jump. Had the rate jumped by d before frame j, the error of the filter would be
that without the jump and F d, its innovation z and G d. With the transition Phi and the gain K of
each frame, H = [I 0] and S the covariance of the innovation

    G = H Phi F,  F <- (I - K H) Phi F,  C <- C + G^T S^-1 G,  y <- y + G^T S^-1 z,

where C starts at J^-1 of the covariance J of jumps and y at zero, d has the mean V y and the
covariance V = C^-1. The jump is exp(y^T V y / 2) sqrt(det V / det J) times as probable as by the
share of frames with a jump, which is learnt.

What is published has the mean and the covariance of the mixture of no jump and one in any of the
last frames. A normal distribution of these moments has no such tails as the mixture. With a jump
that has the probability p the attitude is off by N(m, s^2) about an axis, where s^2 is that of
F V F^T and of the covariance without a jump; its sigma is at least (|m| + c s) / 5, c as of
tail_sigmas(). The filter itself is changed only once a jump is more probable than none: the small
errors of improbable jumps, added in each frame, would be process noise.
"""

import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_rotation_vector
from startracker_ros.core.maths.gates import tail_sigmas
from startracker_ros.core.maths.small_algebra import determinant, inverse

FRAMES = 10
"""In which a jump that one frame does not show comes out."""

SIZE = 4.0
"""Variance of the turn by a jump in one frame, over that of the innovation: the least that shows.
Of larger ones the stars say more than this prior."""

MEMORY = 0.995  # of the frames that the share of jumps is learnt from
FIRST_JUMPS, FIRST_FRAMES = 0.5, 100.0
"""What is assumed before the first frame: so many jumps in so many frames."""

CERTAIN = 0.5  # probability of a jump that the filter follows
MOST_EXPONENT = 50.0  # of a likelihood ratio

MISSED = 4e-5
"""Probability that the attitude is beyond WRONG_SIGMAS by a jump, which is left to chance."""


class Mixture(NamedTuple):
    """
    Errors of the filter by jumps of the rate.

    probability is that of a jump in the last frames, newest that of one since the frame before;
    mean (6,) and covariance (6, 6) are those of the errors of attitude and rate; least (3,) rad
    are the standard deviations of the attitude with which no jump makes it wrong.
    """

    probability: float
    newest: float
    mean: np.ndarray
    covariance: np.ndarray
    least: np.ndarray

    @property
    def is_certain(self) -> bool:
        """Return whether the filter is to follow the jump."""
        return self.probability > CERTAIN


NO_JUMP = Mixture(0.0, 0.0, np.zeros(6), np.zeros((6, 6)), np.zeros(3))


class Memory(NamedTuple):
    """
    What is known of a jump before each of the last frames, in any order; changed in place.

    effect (6, 3 FRAMES) are the F side by side, information (FRAMES, 3, 3) the C, vector
    (FRAMES, 3) the y; prior (FRAMES,) is det J^-1.
    """

    effect: np.ndarray
    information: np.ndarray
    vector: np.ndarray
    prior: np.ndarray


class RateJumps:
    """Weighs jumps of the rate by good frames in turn."""

    def __init__(self) -> None:
        self._memory = Memory(np.zeros((6, 3 * FRAMES)), np.zeros((FRAMES, 3, 3)),
                              np.zeros((FRAMES, 3)), np.zeros(FRAMES))
        self._length = 0
        self._jumps, self._frames = FIRST_JUMPS, FIRST_FRAMES

    @property
    def share(self) -> float:
        """Share of the frames with a jump before them."""
        return self._jumps / self._frames

    def interrupt(self) -> Mixture:
        """Forget jumps before the frames so far; return that there is none."""
        self._length = 0
        return NO_JUMP

    def found(self, *, counts: bool = True) -> Mixture:
        """
        Return that of a jump now known, by a frame that contradicts its prediction.

        It counts where the prediction knew how the body accelerates.
        """
        if counts:
            self._count(1.0)
        return self.interrupt()._replace(newest=1.0)

    def add(self, before_ns: int, predicted: AttitudeState, turn: np.ndarray,
            covariance: np.ndarray) -> Mixture:
        """
        Add a frame; before_ns is the stamp of the one before.

        turn (3,) rad, of covariance (3, 3), is what the stars measure from the prediction.
        """
        mixture = Mixture(*add_frame(
            self._memory, self._length, self.share,
            (predicted.stamp_ns - before_ns) * 1e-9, predicted.rate, predicted.covariance, turn,
            covariance))
        self._length += 1
        self._count(float(mixture.is_certain))
        if mixture.is_certain:
            self.interrupt()
        return mixture

    def _count(self, jumps: float) -> None:
        """Count a frame with so many jumps."""
        self._jumps += (1 - MEMORY) * (FIRST_JUMPS - self._jumps) + jumps
        self._frames += (1 - MEMORY) * (FIRST_FRAMES - self._frames) + 1


@compiled
def add_frame(memory: Memory, length: int, share: float, dt_s: float, rate: np.ndarray,
              P: np.ndarray, turn: np.ndarray, covariance: np.ndarray
              ) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the Mixture of RateJumps.add(), length frames after the last interruption."""
    effect, information, vector, prior = memory
    S_inverse = inverse(P[:3, :3] + covariance)
    transition = np.eye(6)
    transition[:3, :3] = matrix_from_rotation_vector(rate * dt_s).T
    for axis in range(3):
        transition[axis, 3 + axis] = dt_s
    effect[:] = transition @ effect
    newest = length % FRAMES
    information[newest] = S_inverse * (dt_s ** 2 / SIZE)
    prior[newest], vector[newest] = determinant(information[newest]), 0.0
    for axis in range(3):
        # A jump at any time t before the frame: E[t^2] = dt^2 / 3, E[t] = dt / 2.
        effect[:, 3 * newest + axis] = 0.0
        effect[axis, 3 * newest + axis] = dt_s / math.sqrt(3.0)
        effect[3 + axis, 3 * newest + axis] = math.sqrt(0.75)
    G = effect[:3].copy()
    weighted = S_inverse @ G
    effect -= np.ascontiguousarray(P[:6, :3]) @ weighted
    count = min(length + 1, FRAMES)
    ratios, first, second = np.zeros(FRAMES), np.zeros(3 * FRAMES), np.zeros((3 * FRAMES, 6))
    V, d = np.empty((FRAMES, 3, 3)), np.zeros((FRAMES, 3))
    for k in range(count):
        for i in range(3):
            for j in range(3):
                vector[k, i] += weighted[j, 3 * k + i] * turn[j]
                for row in range(3):
                    information[k, i, j] += G[row, 3 * k + i] * weighted[row, 3 * k + j]
        V[k], exponent = inverse(information[k]), 0.0
        for i in range(3):
            for j in range(3):
                d[k, i] += V[k, i, j] * vector[k, j]
            exponent += d[k, i] * vector[k, i] / 2
        ratios[k] = share * math.exp(min(exponent, MOST_EXPONENT)) * math.sqrt(
            prior[k] / determinant(information[k]))
        for i in range(3):
            first[3 * k + i] = ratios[k] * d[k, i]
            for j in range(3):
                moment = ratios[k] * (V[k, i, j] + d[k, i] * d[k, j])
                for row in range(6):
                    second[3 * k + i, row] += moment * effect[row, 3 * k + j]
    total = 1 + ratios.sum()
    mean = effect @ first / total
    attitude = np.ascontiguousarray(P[:3, :3])
    without = np.diag(attitude) - np.diag(attitude @ S_inverse @ attitude)
    least = np.zeros(3)
    for k in range(count):
        tail = tail_sigmas(ratios[k] / total, MISSED)
        if tail == 0:
            continue
        F = np.ascontiguousarray(effect[:3, 3 * k:3 * k + 3])
        error, variance = F @ d[k] - mean[:3], np.diag(F @ V[k] @ F.T) + without
        for axis in range(3):
            least[axis] = max(least[axis], (
                abs(error[axis]) + tail * math.sqrt(variance[axis])) / WRONG_SIGMAS)
    return (1 - 1 / total, ratios[newest] / total, mean,
            effect @ second / total - np.outer(mean, mean), least)
