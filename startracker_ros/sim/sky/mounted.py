# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A head on a body that moves: its mount, how the mount bends with temperature, its seed."""

from dataclasses import dataclass
import zlib

import numpy as np
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.motion_state import Motion, MotionState

_NORM_TOLERANCE = 1e-3


@dataclass(frozen=True)
class HeadOptions(Options):
    """Where the sensor is mounted on the body that moves, and how that mount bends."""

    body_frame_id: str = option(
        '', 'child frame of motion/odometry where that is the motion of the body, not of the '
        'sensor; empty: sensor_frame_id')
    mount_quaternion: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 1.0), 'rotation body from sensor in the order x, y, z, w: v_body = R(q) '
        'v_sensor; pointing and rate of the motion are those of the body', low=-1.0, high=1.0)
    bend_arcsec_k: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), 'rotation of the mount about body x, y, z for each kelvin above '
        'temperature_c', unit='arcsec/K', low=-1000.0, high=1000.0)
    temperature_c: float = option(20.0, 'mean temperature of the head', unit='degC', low=-200.0,
                                  high=200.0)
    temperature_swing_k: float = option(
        0.0, 'amplitude of the temperature, a sine that is zero at time 0', unit='K', low=0.0,
        high=200.0)
    temperature_period_s: float = option(5700.0, 'period of the temperature: that of the orbit',
                                         unit='s', low=1.0, high=1e7)

    def __post_init__(self) -> None:
        """Check the fields; ValueError for a mount_quaternion that is not a rotation."""
        super().__post_init__()
        norm = float(np.linalg.norm(self.mount_quaternion))
        if abs(norm - 1) > _NORM_TOLERANCE:
            raise ValueError(f'mount_quaternion = {list(self.mount_quaternion)} is of norm '
                             f'{norm:.4f}, a rotation has norm 1')

    def temperature_at(self, time_s: float) -> float:
        """Return the temperature of the head in degC."""
        return self.temperature_c + self.temperature_swing_k * float(np.sin(self._phase(time_s)))

    def mount_at(self, time_s: float) -> np.ndarray:
        """Return q_body_from_sensor (4,): exp([b]x) R(mount), with the bending b in rad."""
        bend = (self.temperature_at(time_s) - self.temperature_c) * self._slope_rad_k
        return multiply(quaternion_from_rotation_vector(bend), self._nominal)

    def bending_rate_at(self, time_s: float) -> np.ndarray:
        """Return the rate (3,) rad/s of the sensor against the body, about body axes."""
        rate_k_s = (2 * np.pi / self.temperature_period_s * self.temperature_swing_k
                    * np.cos(self._phase(time_s)))
        return rate_k_s * self._slope_rad_k

    def _phase(self, time_s: float) -> float:
        return 2 * np.pi * time_s / self.temperature_period_s

    @property
    def _slope_rad_k(self) -> np.ndarray:
        return np.array(self.bend_arcsec_k) * ARCSEC

    @property
    def _nominal(self) -> np.ndarray:
        quaternion = np.array(self.mount_quaternion)
        return quaternion / np.linalg.norm(quaternion)


@dataclass(frozen=True)
class MountedMotion:
    """The motion of a sensor by that of the body, which has it as q_icrf_from_sensor."""

    body: Motion
    options: HeadOptions

    def at(self, time_s: float) -> MotionState:
        """Return the state of the sensor; position and velocity are those of the body."""
        body, mount = self.body.at(time_s), self.options.mount_at(time_s)
        rate_rad_s = body.rate_rad_s + self.options.bending_rate_at(time_s)
        return MotionState(multiply(body.q_icrf_from_sensor, mount),
                           rotate(conjugate(mount), rate_rad_s), body.position_m,
                           body.velocity_m_s)


def mounted(body: Motion, options: HeadOptions) -> Motion:
    """Return the motion of a sensor on a body."""
    return body if options == HeadOptions() else MountedMotion(body, options)


def seed_in_namespace(seed: int, namespace: str) -> int:
    """Return the seed of a head: that of the options, changed by a namespace that is not empty."""
    return (seed + zlib.crc32(namespace.strip('/').encode())) % 2 ** 32
