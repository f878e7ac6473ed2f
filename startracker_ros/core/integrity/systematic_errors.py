# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The covariance that systematic errors of the stars add to an attitude fitted to them.

The attitude is fitted to stars with directions p on sensor axes and weights w = 1 / sigma^2. Its
Fisher information is F = sum w (I - p p^T).
"""

from dataclasses import replace

import numpy as np
from startracker_ros.core.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.core.astro.observer_motion import Observer
from startracker_ros.core.attitude.error_budget import NO_ERROR
from startracker_ros.core.attitude.estimate import cramer_rao, information
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.maths.rotation import matrix_from_quaternion


def with_observer_error(attitude: AttitudeEstimate, observer: Observer, sensor: np.ndarray,
                        sigma: np.ndarray, motion: np.ndarray | None = None) -> AttitudeEstimate:
    """
    Return an attitude whose covariance contains what is not known of the observer.

    That is its velocity, as velocity_covariance(), and the epoch of the stars, where motion (N, 3)
    is their proper motion in rad a year on ICRS axes, as epoch_covariance().
    """
    if observer.velocity_sigma_m_s:
        attitude = replace(
            attitude, covariance_sensor=attitude.covariance_sensor + velocity_covariance(
                observer.velocity_sigma_m_s, sensor, sigma))
    return replace(attitude, covariance_sensor=attitude.covariance_sensor + epoch_covariance(
        attitude.quaternion, observer.epoch_sigma_years, sensor, sigma, motion))


def epoch_covariance(quaternion: np.ndarray, sigma_years: float, sensor: np.ndarray,
                     sigma: np.ndarray, motion: np.ndarray | None) -> np.ndarray:
    """
    Return the covariance (3, 3) rad^2 by an error of the epoch of the stars.

    sensor (N, 3) and sigma (N,) are those of velocity_covariance(). Proper motions m (N, 3), rad a
    year on ICRS axes, turn the best fit by F^-1 sum w (p x m) in a year; None where unknown.
    """
    if motion is None or not sigma_years or len(sensor) < 2:
        return NO_ERROR
    weight = 1 / sigma ** 2
    on_sensor = motion @ matrix_from_quaternion(quaternion)
    turn = cramer_rao(sensor, sigma) @ (weight @ np.cross(sensor, on_sensor))
    return sigma_years ** 2 * np.outer(turn, turn)


def velocity_covariance(velocity_sigma_m_s: float, sensor: np.ndarray, sigma: np.ndarray
                        ) -> np.ndarray:
    """
    Return the covariance (3, 3) rad^2 by an unknown velocity, of 1 sigma on each axis.

    sensor (N, 3) are the directions p, sigma (N,) their errors in any unit. A velocity v shifts a
    star by (v - (v.p) p) / c, which turns the best fit by F^-1 (s x v) / c with s = sum w p: about
    the axes across the boresight by v / c, about the boresight by some v / c times the angle of
    the field. The covariance of the turn is (sigma_v / c)^2 F^-1 (s^2 I - s s^T) F^-1.
    """
    s = sigma ** -2.0 @ sensor
    F_inverse = np.linalg.inv(information(sensor, sigma))
    across = s @ s * np.eye(3) - np.outer(s, s)
    return (velocity_sigma_m_s / SPEED_OF_LIGHT_M_S) ** 2 * (F_inverse @ across @ F_inverse)
