# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated sensors in addition to the camera: rate gyro and navigation."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.options import option, Options

_DEG_H = np.radians(1 / 3600)
_DEG_SQRT_H = np.radians(1 / 60)


@dataclass(frozen=True)
class GyroOptions(Options):
    """A tactical-grade MEMS gyro with the constant drift of 1 deg/h of the extended-grid paper."""

    gyro_rate_hz: float = option(100.0, 'measurement rate', unit='Hz', low=0.1, high=10000.0)
    gyro_bias_deg_h: tuple[float, float, float] = option(
        (1.0, 1.0, 1.0), 'initial bias about sensor x, y, z', unit='deg/h',
        low=-10000.0, high=10000.0)
    gyro_bias_walk_deg_h_sqrt_h: float = option(
        0.1, 'random walk of the bias (rate random walk), each axis', unit='deg/h/sqrt(h)',
        low=0.0, high=10000.0)
    gyro_noise_deg_sqrt_h: float = option(
        0.15, 'white noise (angle random walk), each axis', unit='deg/sqrt(h)',
        low=0.0, high=100.0)


class Gyro:
    """Produces consecutive measurements; the bias is a random walk."""

    def __init__(self, options: GyroOptions = GyroOptions(), *,
                 rng: np.random.Generator) -> None:
        """Start with the bias of the options; every measurement draws from rng."""
        self._rng = rng
        self._noise = options.gyro_noise_deg_sqrt_h * _DEG_SQRT_H
        self._walk = options.gyro_bias_walk_deg_h_sqrt_h * _DEG_H / 60
        self.bias_rad_s = np.array(options.gyro_bias_deg_h) * _DEG_H

    def measure(self, rate_rad_s: np.ndarray, dt_s: float) -> np.ndarray:
        """
        Return the mean rate (3,) in rad/s over the last dt_s, given the true one.

        Discrete form of the model of Farrenkopf (1978): white noise and bias random walk.
        """
        before = self.bias_rad_s
        self.bias_rad_s = before + self._walk * np.sqrt(dt_s) * self._rng.standard_normal(3)
        sigma = np.sqrt(self._noise ** 2 / dt_s + self._walk ** 2 * dt_s / 12)
        return (rate_rad_s + (before + self.bias_rad_s) / 2
                + sigma * self._rng.standard_normal(3))


@dataclass(frozen=True)
class NavigationOptions(Options):
    """Errors of the simulated navigation, 1 sigma on each axis, and its frame."""

    position_sigma_m: float = option(10.0, 'error of the position in odometry, 1 sigma per axis',
                                     unit='m', low=0.0, high=1e5)
    velocity_sigma_m_s: float = option(
        0.033, 'error of the velocity in odometry, 1 sigma per axis', unit='m/s', low=0.0,
        high=1e3)
    satellite_frame_id: str = option(
        'satellite', 'child frame of odometry: at the satellite, with the axes of the inertial '
        'frame')

    def measured(self, position_m: np.ndarray, velocity_m_s: np.ndarray,
                 rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) and velocity (3,) with noise."""
        return (position_m + rng.normal(0, self.position_sigma_m, 3),
                velocity_m_s + rng.normal(0, self.velocity_sigma_m_s, 3))
