# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How much larger the errors of a head are than its covariance says, from its innovations."""

from collections.abc import Iterable

from startracker_ros.core.fusion.state import GATE

_MEAN = 3.0  # of the normalised innovation squared of an attitude
_FRAMES = 32  # over which it is averaged
_SUSPICIOUS = 1.5  # times that of the best other head; 5 sigma of the average
_RATE = 1 / 64  # slower than the average, so that the scale does not oscillate


class HeadNoise:
    """
    The scale by which the covariance of a head is multiplied.

    It matches the normalised innovation squared (NIS) with its expectation (covariance matching,
    Mehra, IEEE Trans. Autom. Control 17, 1972). Only a head that stands out from the best of the
    others is scaled: a manoeuvre or a wrong gyro enlarges the innovations of all heads.
    """

    def __init__(self) -> None:
        self.scale = 1.0
        self._nis = _MEAN

    @property
    def stands_out(self) -> bool:
        """Whether the errors are so large that a user should know."""
        return self.scale > _SUSPICIOUS

    def add(self, nis: float, others: Iterable['HeadNoise']) -> None:
        """Use the NIS of a frame; others are those of the other heads that count, if any."""
        self._nis += (min(nis, GATE) - self._nis) / _FRAMES
        expected = min((other._nis for other in others), default=None)
        if expected is None:
            return
        ratio = self._nis / max(expected, _MEAN)
        if ratio > _SUSPICIOUS or self.scale > 1:
            self.scale = max(1.0, self.scale * (1 + _RATE * (ratio - 1)))
