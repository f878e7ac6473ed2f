# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The phases of a mission: which reference the controller follows, and when the next begins."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from startracker_evaluation.gnc.guidance import Reference, Slew
from startracker_evaluation.gnc.navigation import NavigationState


class Phase(StrEnum):
    """Phases, in order."""

    DETUMBLE = 'detumble'
    ACQUIRE = 'lost in space'
    SLEW = 'slew'
    SETTLE = 'settle'
    FINE = 'fine pointing'
    BLINDED = 'blinded by the Sun'
    RECOVERED = 'recovered'


@dataclass(frozen=True)
class PlanOptions:
    """
    When the phases end.

    Detumbling ends below rate_rad_s by the gyro, kept for still_s; the slew begins acquire_s
    after the first attitude of the navigation, by slew_rad about slew_axis (3,) on body axes;
    fine pointing begins settle_s after its end, blinded fine_s later for blinded_s. The run
    ends recovered_s later. Without blinded_s fine pointing goes on to the end.
    """

    rate_rad_s: float = float(np.radians(0.05))
    still_s: float = 2.0
    acquire_s: float = 10.0
    slew_rad: float = float(np.radians(90.0))
    slew_axis: tuple[float, float, float] = (0.6, 0.0, 0.8)
    settle_s: float = 60.0
    fine_s: float = 60.0
    blinded_s: float = 30.0
    recovered_s: float = 60.0


class Plan:
    """
    Goes from phase to phase by what the navigation knows, never by the truth.

    begins_s has the time in s at which each phase began; finished: the last one is over.
    """

    def __init__(self, options: PlanOptions = PlanOptions()) -> None:
        self.options = options
        self.phase = Phase.DETUMBLE
        self.begins_s: dict[Phase, float] = {Phase.DETUMBLE: 0.0}
        self.slew: Slew | None = None
        self.finished = False
        self._still_since_s: float | None = None
        self._attitude_since_s: float | None = None

    @property
    def damps_rate(self) -> bool:
        """Return whether only the rate is controlled."""
        return self.slew is None

    def update(self, time_s: float, gyro_rad_s: np.ndarray, state: NavigationState | None
               ) -> bool:
        """Return whether a phase began, by the rate (3,) of the gyro and the navigation."""
        before, options = self.phase, self.options
        since_s = time_s - self.begins_s[before]
        if before is Phase.DETUMBLE:
            still = bool(np.linalg.norm(gyro_rad_s) < options.rate_rad_s)
            self._still_since_s = _since(still, self._still_since_s, time_s)
            if still and time_s - (self._still_since_s or 0.0) >= options.still_s:
                self.phase = Phase.ACQUIRE
        elif before is Phase.ACQUIRE:
            self._attitude_since_s = _since(state is not None, self._attitude_since_s, time_s)
            if state is not None and time_s - (self._attitude_since_s or 0.0) >= options.acquire_s:
                self.phase = Phase.SLEW
                axis = np.array(options.slew_axis) / np.linalg.norm(options.slew_axis)
                self.slew = Slew(state.q_icrf_from_body, axis, options.slew_rad, time_s)
        elif before is Phase.SLEW:
            assert self.slew is not None
            if time_s >= self.slew.end_s:
                self.phase = Phase.SETTLE
        elif before is Phase.SETTLE and since_s >= options.settle_s:
            self.phase = Phase.FINE
        elif before is Phase.FINE and since_s >= options.fine_s:
            self.phase, self.finished = (
                (Phase.BLINDED, False) if options.blinded_s else (before, True))
        elif before is Phase.BLINDED and since_s >= options.blinded_s:
            self.phase = Phase.RECOVERED
        elif before is Phase.RECOVERED and since_s >= options.recovered_s:
            self.finished = True
        if self.phase is not before:
            self.begins_s[self.phase] = time_s
        return self.phase is not before

    def reference(self, time_s: float, q_icrf_from_body: np.ndarray) -> Reference:
        """Return the reference of a time; while the rate is damped, the attitude itself."""
        return (Reference.fixed(q_icrf_from_body) if self.slew is None
                else self.slew.at(time_s))


def _since(holds: bool, since_s: float | None, time_s: float) -> float | None:
    """Return since when a condition holds, None while it does not."""
    if not holds:
        return None
    return time_s if since_s is None else since_s
