# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gyro noise has the sizes its options name."""

import numpy as np
import pytest
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions

DEG_H = np.radians(1 / 3600)
RATE = np.array([0.01, -0.02, 0.03])
SILENT = {'gyro_bias_walk_deg_h_sqrt_h': 0.0, 'gyro_noise_deg_sqrt_h': 0.0}


def test_without_noise_only_the_bias_is_added():
    gyro = Gyro(GyroOptions(gyro_bias_deg_h=(1.0, 2.0, -3.0), **SILENT),
                rng=np.random.default_rng(1))
    np.testing.assert_allclose(gyro.measure(RATE, 0.01) - RATE, np.array([1, 2, -3]) * DEG_H)


@pytest.mark.parametrize('dt_s', [0.01, 1.0])
def test_angle_random_walk(dt_s):
    """After an hour the integrated angle is off by the figure, whatever the rate of samples."""
    options = GyroOptions(gyro_bias_deg_h=(0.0, 0.0, 0.0), gyro_noise_deg_sqrt_h=0.15,
                          gyro_bias_walk_deg_h_sqrt_h=0.0)
    gyro = Gyro(options, rng=np.random.default_rng(2))
    noise = np.array([gyro.measure(RATE, dt_s) - RATE for _ in range(4000)])
    hour_deg = np.degrees(noise.std() * dt_s * np.sqrt(3600 / dt_s))
    assert hour_deg == pytest.approx(0.15, rel=0.03)
    assert np.abs(noise.mean(0)).max() < 4 * noise.std() / np.sqrt(4000)


def test_bias_random_walk():
    """The standard deviation of the bias after an hour is that of the options."""
    options = GyroOptions(gyro_bias_walk_deg_h_sqrt_h=0.5, gyro_noise_deg_sqrt_h=0.0)
    change = []
    for seed in range(300):
        gyro = Gyro(options, rng=np.random.default_rng(seed))
        for _ in range(4):
            gyro.measure(RATE, 900.0)
        change.append(gyro.bias_rad_s / DEG_H - 1.0)
    assert np.std(change) == pytest.approx(0.5, rel=0.1)
