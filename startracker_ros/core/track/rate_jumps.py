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
from startracker_ros.core.attitude.attitude_state import AttitudeState, Prediction
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.compiled_rotation import matrix_from_rotation_vector
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


@compiled
def tail_sigmas(probability: float, missed: float) -> float:
    """
    Return the c beyond which such an error lies on one side with no more than a probability.

    The error itself has the probability p: p exp(-c^2 / 2) / 2 = missed (a bound of the normal
    integral). 0 where no c is needed.
    """
    if probability <= 2 * missed:
        return 0.0
    return math.sqrt(2 * math.log(probability / (2 * missed)))


# --- jumps of the rate within an exposure that the gain of the filter hides ---
#
# Where the rate jumps after the middle of an exposure, the stars are seen where the body is not
# yet. A filter that is to follow motions which begin takes most of what a frame measures, and its
# innovations are second differences of the noise. But a body that has turned steadily is known
# better: beside the filter runs one with the process noise that there is, k times that of the
# filter (process_noise.py), about each axis D^2 Q with D = diag(sqrt(k)). It is kept as the
# difference x of its state and that of the filter, with its own covariance P_k:
#
#     x- = Phi x,  P_k- = Phi P_k Phi^T + D Q D,  v = z - H x-,  S = H P_k- H^T + R,
#
# z the turn that the stars measure from the prediction of the filter, R its covariance. A jump
# before the frame, of a variance SIZE S / dt^2 as above, is for its chi-square
# v^T S^-1 v so much more probable than none:
#
#     share (1 + a)^(-3/2) exp(v^T S^-1 v a / (1 + a) / 2),  a = SIZE / 3.

LEAST_RATIO = 0.01
"""Of the process noise: no body turns so steadily that frames of a minute ago tell its rate."""

_A = SIZE / 3  # E[t^2] = dt^2 / 3 of the time t since the jump


class HiddenJumps:
    """
    Weighs jumps since the frame before, by good frames in turn.

    probability is that of such a jump; expected (3,) rad is where the steady body was to be, from
    the prediction of the filter, about sensor axes, and unexpected (3,) what the stars measure
    from there.
    """

    def __init__(self) -> None:
        self._difference, self._own = np.zeros(6), np.zeros((6, 6))
        self.interrupt()

    def interrupt(self) -> None:
        """Begin anew with the state of the filter after the next frame."""
        self._started = False
        self.probability, self.expected, self.unexpected = 0.0, np.zeros(3), np.zeros(3)

    def add(self, prediction: Prediction, turn: np.ndarray, turn_covariance: np.ndarray,
            ratio: np.ndarray, share: float) -> None:
        """
        Add a frame with this prediction of the filter.

        turn (3,) rad, of covariance (3, 3), is what its stars measure from there; ratio (3,) is k
        and share the one of frames with a jump.
        """
        chi2, self.expected = add_steady_frame(
            self._difference, self._own, self._started, prediction.transition, prediction.process,
            prediction.state.covariance, turn, turn_covariance, ratio)
        self.unexpected = turn - self.expected
        exponent = chi2 / 2 * _A / (1 + _A)
        odds = (share * (1 + _A) ** -1.5 * math.exp(min(exponent, MOST_EXPONENT))
                if self._started else 0.0)
        self.probability = odds / (1 + odds)
        # The next frame has the rest of a jump, and the steady motion is another one from then on.
        self._started = self.probability <= CERTAIN


@compiled
def add_steady_frame(difference: np.ndarray, own: np.ndarray, started: bool,
                     transition: np.ndarray, process: np.ndarray, P: np.ndarray,
                     turn: np.ndarray, R: np.ndarray, ratio: np.ndarray
                     ) -> tuple[float, np.ndarray]:
    """
    Add a frame to x (6,) and P_k (6, 6), which are changed in place.

    Return v^T S^-1 v and H x-, once it has started; else it begins with P (9, 9) of the
    prediction.
    """
    if started:
        Phi = np.ascontiguousarray(transition[:6, :6])
        difference[:] = Phi @ difference
        own[:] = Phi @ own @ Phi.T
        for i in range(6):
            for j in range(6):
                own[i, j] += process[i, j] * math.sqrt(
                    max(ratio[i % 3], LEAST_RATIO) * max(ratio[j % 3], LEAST_RATIO))
    else:
        difference[:] = 0.0
        own[:] = P[:6, :6]
    expected = difference[:3].copy()
    v = turn - expected
    S_inverse = inverse(np.ascontiguousarray(own[:3, :3]) + R)
    weighted = S_inverse @ v
    gain = np.ascontiguousarray(own[:, :3]) @ S_inverse
    difference += gain @ v
    own -= gain @ np.ascontiguousarray(own[:3])
    # The filter is corrected by its own gain.
    columns = np.ascontiguousarray(P[:6, :3])
    difference -= columns @ (inverse(np.ascontiguousarray(P[:3, :3]) + R) @ turn)
    return v @ weighted, expected
