# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion that is not uniform within an exposure, vibration and sudden kicks, and a smooth sway."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.maths.rotation import quaternion_from_rotation_vector
from startracker_ros.sim.sky.motion_state import Motion, MotionState

_INSTANTS = 65  # odd, so that one is the middle of the exposure


@dataclass(frozen=True)
class Shaking:
    """
    What a shake does within one exposure.

    mean_rad (2,) is the mean pointing of the exposure minus that at its middle, about sensor x
    and y; rms_rad the root mean square distance of the pointing from its mean.
    """

    mean_rad: np.ndarray
    rms_rad: float


STILL = Shaking(np.zeros(2), 0.0)


@dataclass(frozen=True)
class ShakenMotion:
    """
    A motion with small turns about sensor x and y added, from time 0 on.

    vibration_rad is the amplitude of a sine of vibration_hz in a direction and with a phase of
    the seed. Once in each kick_period_s, at a random instant of it, the pointing jumps by kick_rad
    in a random direction; the next kick brings it back.
    """

    steady: Motion
    vibration_rad: float
    vibration_hz: float
    kick_rad: float
    kick_period_s: float
    seed: int

    def at(self, time_s: float) -> MotionState:
        """Return the state; draws all kicks up to time_s, 1 us for a hundred of them."""
        turn = quaternion_from_rotation_vector([*self._turn(np.array([time_s]))[0], 0.0])
        vibration, phase = self._vibration(np.array([time_s]))
        rate = vibration * 2 * np.pi * self.vibration_hz * np.cos(phase)[0]
        return self.steady.at(time_s).turned(turn, [*rate, 0.0])

    @property
    def reach_rad(self) -> float:
        """Return the largest angle from the steady pointing."""
        return self.vibration_rad + self.kick_rad

    def shaking(self, time_s: float, exposure_s: float) -> Shaking:
        """Return what the shake does within an exposure centred at time_s."""
        instants_s, weight = uneven_instants(exposure_s)
        turn = self._turn(time_s + instants_s)
        mean = weight @ turn
        rms_rad = np.sqrt(weight @ np.sum((turn - mean) ** 2, axis=1))
        return Shaking(mean - turn[len(turn) // 2], float(rms_rad))

    def _turn(self, time_s: np.ndarray) -> np.ndarray:
        """Return the turns (K, 2) about x and y at times (K,)."""
        vibration, phase = self._vibration(time_s)
        return vibration * np.sin(phase)[:, None] + self._kicked(time_s)

    def _vibration(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the amplitude (2,) about x and y and the phases (K,)."""
        direction, phase = np.random.default_rng([self.seed, 0]).uniform(0, 2 * np.pi, 2)
        amplitude = self.vibration_rad * np.array([np.cos(direction), np.sin(direction)])
        return amplitude, 2 * np.pi * self.vibration_hz * time_s + phase

    def _kicked(self, time_s: np.ndarray) -> np.ndarray:
        """Return the turns (K, 2) by kicks."""
        period, within = np.divmod(np.maximum(time_s, 0.0) / self.kick_period_s, 1)
        period = period.astype(int)
        instant, angle = np.random.default_rng([self.seed, 1]).random(
            (period.max() + 1, 2)).T * [[1.0], [2 * np.pi]]
        kicks = period + (within >= instant[period])
        newest = angle[np.maximum(kicks - 1, 0)]
        away = np.where(kicks % 2, self.kick_rad, 0.0)
        return away[:, None] * np.stack([np.cos(newest), np.sin(newest)], -1)


def uneven_instants(exposure_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return instants (K,) in s from the middle of an exposure and their equal weights (K,)."""
    instants = ((np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5) * exposure_s
    return instants, np.full(_INSTANTS, 1 / _INSTANTS)


@dataclass(frozen=True)
class SwayingMotion:
    """
    A motion with a sinusoidal turn added about an axis (3,) of unit length on sensor axes.

    angle = amplitude_rad sin(2 pi t / period_s + phase_rad).
    """

    steady: Motion
    axis: np.ndarray
    amplitude_rad: float
    period_s: float
    phase_rad: float = 0.0

    def at(self, time_s: float) -> MotionState:
        """Return the state."""
        w = 2 * np.pi / self.period_s
        phase = w * time_s + self.phase_rad
        turn = quaternion_from_rotation_vector(self.axis * self.amplitude_rad * np.sin(phase))
        return self.steady.at(time_s).turned(
            turn, self.axis * self.amplitude_rad * w * np.cos(phase))
