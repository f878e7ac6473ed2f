# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Smoothed attitudes: the truth within their covariance, over gaps and manoeuvres."""

from chi_square import check_mean
import numpy as np
import pytest
from startracker_ros.core.attitude.smoothing import MotionNoise, smooth
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector, random_attitude)

N, DT_S = 200, 1.0
SINGLE = np.diag([1.0, 1.0, 8.0]) ** 2 * ARCSEC ** 2
NOISE = MotionNoise(np.radians(np.full(3, 2e-4)) ** 2, (np.radians(0.005) / 60) ** 2,
                    (np.radians(0.2) / 3600) ** 2 / 3600, np.radians(3 / 3600))
BIAS = np.radians([1.0, -2.0, 0.5]) / 3600


def flight(seed, jump_rad_s=0.0):
    """Return true attitudes, measured ones, and what a gyro measures."""
    rng = np.random.default_rng(seed)
    q, rate = random_attitude(rng), np.radians([0.05, -0.03, 0.02])
    truth, gyro = [q], [np.full(3, np.nan)]
    for k in range(1, N):
        after = rate + rng.normal(0, 1, 3) * np.sqrt(NOISE.acceleration_density * DT_S)
        after[0] += jump_rad_s * (k == N // 2)
        turn = (rate + after) / 2 * DT_S
        q, rate = multiply(q, quaternion_from_rotation_vector(turn)), after
        truth.append(q)
        gyro.append(turn / DT_S + BIAS + rng.normal(0, np.sqrt(NOISE.gyro_density / DT_S), 3))
    truth = np.array(truth)
    noise = rng.multivariate_normal(np.zeros(3), SINGLE, N)
    return truth, multiply(truth, quaternion_from_rotation_vector(noise)), np.array(gyro)


def smoothed(measured, gyro=None):
    return smooth((np.arange(N) * DT_S * 1e9).astype(np.int64), measured,
                  np.tile(SINGLE, (N, 1, 1)), NOISE, gyro)


def nees(found, truth):
    error = attitude_error(found.quaternion, truth)
    information = np.linalg.inv(found.covariance[:, :3, :3])
    return np.einsum('ni,nij,nj->n', error, information, error)


@pytest.mark.parametrize('with_gyro', [False, True])
def test_errors_are_those_of_the_covariance_over_a_gap(with_gyro):
    values = []
    for seed in range(2):
        truth, measured, gyro = flight(seed)
        measured[90:115] = np.nan
        found = smoothed(measured, gyro if with_gyro else None)
        values.append(nees(found, truth))
        error = attitude_error(found.quaternion, truth)[np.r_[0:85, 120:N], :2]
        rms = np.sqrt(np.mean(error ** 2)) / ARCSEC
        assert rms < 0.8
        inside = found.covariance[90:115, 0, 0]
        assert inside.max() > found.covariance[40, 0, 0]
    check_mean(3, *values)


def test_gyro_bias_is_found():
    _, measured, gyro = flight(5)
    found = smoothed(measured, gyro)
    error = (found.bias_rad_s - BIAS)[N // 2]
    sigma = np.sqrt(np.diagonal(found.covariance[N // 2])[6:])
    assert np.all(np.abs(error) < 4 * sigma) and sigma.max() < np.radians(1.0 / 3600)


def test_a_manoeuvre_gives_no_wrong_attitude():
    truth, measured, _ = flight(6, jump_rad_s=np.radians(0.05))
    assert nees(smoothed(measured), truth).max() < 60
