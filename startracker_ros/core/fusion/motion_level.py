# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How much the rate of a body changes, by the innovations of the heads.

The process noise is level times the assumed one. With P_Q the part of the covariance by it, the
score of process_noise.py tells by how much it is off: where the sum of the scores of the frames
so far is beyond SURE standard deviations, the level is k times as large, and so is P_Q.
"""

import numpy as np
from startracker_ros.core.attitude.attitude_state import Prediction
from startracker_ros.core.fusion.state import BODY, FusedState, Innovation
from startracker_ros.core.track.process_noise import add_frame, ASSUMED, Memory

SURE = 2.0
FIRST = 100.0  # of a body of which no frame has shown how it moves
MOST, LEAST = 100.0, 0.2  # times as large at once
HIGHEST = 1e8  # of the level, beyond which nothing is predicted


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
