# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Jumps of the rate within an exposure that the gain of the filter hides.

Where the rate jumps after the middle of an exposure, the stars are seen where the body is not yet.
A filter that is to follow motions which begin takes most of what a frame measures, and its
innovations are second differences of the noise. But a body that has turned steadily is known
better: beside the filter runs one with the process noise that there is, k times that of the
filter (process_noise.py), about each axis D^2 Q with D = diag(sqrt(k)). It is kept as the
difference x of its state and that of the filter, with its own covariance P_k:

    x- = Phi x,  P_k- = Phi P_k Phi^T + D Q D,  v = z - H x-,  S = H P_k- H^T + R,

z the turn that the stars measure from the prediction of the filter, R its covariance. A jump
before the frame, of a variance SIZE S / dt^2 as in rate_jumps.py, is for its chi-square
v^T S^-1 v so much more probable than none:

    share (1 + a)^(-3/2) exp(v^T S^-1 v a / (1 + a) / 2),  a = SIZE / 3.
"""

import math

import numpy as np
from startracker_ros.core.attitude.attitude_state import Prediction
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.small_algebra import inverse
from startracker_ros.core.track.rate_jumps import CERTAIN, MOST_EXPONENT, SIZE

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
        chi2, self.expected = add_frame(
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
def add_frame(difference: np.ndarray, own: np.ndarray, started: bool, transition: np.ndarray,
              process: np.ndarray, P: np.ndarray, turn: np.ndarray, R: np.ndarray,
              ratio: np.ndarray) -> tuple[float, np.ndarray]:
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
