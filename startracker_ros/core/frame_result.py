# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the star tracker knows after a frame."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from startracker_ros.core.astro.epoch import checked_stamp
from startracker_ros.core.attitude.result import AttitudeEstimate, covariance_icrf
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.core.track.tracks import Acceleration, TrackedAttitude, Tracks


@dataclass(frozen=True, kw_only=True)
class Attitude(AttitudeEstimate):
    """
    The attitude of the sensor in ICRF at a time, with that of its stars.

    quaternion (4,) is q_icrf_from_sensor, x, y, z, w: v_icrf = R(q) v_sensor; covariance_sensor
    (3, 3) rad^2 that of a rotation vector about sensor axes. rate_rad_s (3,) is the angular
    velocity with respect to ICRF on sensor axes, with its covariance (3, 3) rad^2/s^2;
    cross_covariance (3, 3) rad^2/s is that of the errors of attitude (rows) and rate, None where
    it is not known. shown_rad_s2 (3,) is the angular acceleration that the frames show, with its
    change jerk_rad_s3 (3,); acceleration_rad_s2 (3,) is the 1 sigma of its error after
    the frame, before_rad_s2 (3,) before it.
    protection_rad (3,) bounds the errors about sensor axes, but for misleading_probability;
    infinite where there is no bound, and at another time, where budget is None.
    """

    stamp_ns: int
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray
    acceleration_rad_s2: np.ndarray
    shown_rad_s2: np.ndarray = field(default_factory=lambda: np.zeros(3))
    jerk_rad_s3: np.ndarray = field(default_factory=lambda: np.zeros(3))
    before_rad_s2: np.ndarray = field(default_factory=lambda: np.zeros(3))
    cross_covariance: np.ndarray | None = None
    protection_rad: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))

    @classmethod
    def of(cls, stamp_ns: int, own: AttitudeEstimate, tracked: TrackedAttitude,
           acceleration: Acceleration, **known: Any) -> 'Attitude':
        """Return a trusted attitude with the motion of the tracker; known are other fields."""
        return cls(
            quaternion=own.quaternion, covariance_sensor=own.covariance_sensor, stars=own.stars,
            residual_rad=own.residual_rad, chi2=own.chi2, budget=own.budget, stamp_ns=stamp_ns,
            rate_rad_s=tracked.rate_rad_s, rate_covariance=tracked.rate_covariance,
            acceleration_rad_s2=acceleration.sigma, shown_rad_s2=acceleration.mean,
            jerk_rad_s3=acceleration.jerk, before_rad_s2=acceleration.before, **known)

    @classmethod
    def of_result(cls, trusted: np.ndarray, tracked: TrackedAttitude, residual_rad: np.ndarray
           ) -> 'Attitude':
        """Return a trusted ATTITUDE, which it is a view of, with the budget of tracked."""
        cross = trusted['cross_covariance']
        return cls(
            quaternion=trusted['quaternion'], covariance_sensor=trusted['covariance_rad2'],
            stars=int(trusted['stars']), residual_rad=residual_rad, chi2=float(trusted['chi2']),
            budget=tracked.attitude.budget, stamp_ns=int(trusted['stamp_ns']),
            rate_rad_s=trusted['rate_rad_s'], rate_covariance=trusted['rate_covariance'],
            acceleration_rad_s2=trusted['acceleration_sigma_rad_s2'],
            shown_rad_s2=trusted['acceleration_rad_s2'], jerk_rad_s3=trusted['jerk_rad_s3'],
            before_rad_s2=trusted['acceleration_sigma_before_rad_s2'],
            cross_covariance=None if np.isnan(cross[0, 0]) else cross,
            protection_rad=trusted['protection_rad'])

    def sub_frames(self, count: int, interval_ns: int) -> list['Attitude']:
        """Return at() of so many times, evenly over a frame interval about stamp_ns."""
        return [self.at(self.stamp_ns + round(((k + 0.5) / count - 0.5) * interval_ns))
                for k in range(count)]

    @property
    def covariance_icrf(self) -> np.ndarray:
        """Covariance (3, 3) rad^2 of the same rotation vector on ICRF axes."""
        return covariance_icrf(self.quaternion, self.covariance_sensor)

    def at(self, stamp_ns: int) -> 'Attitude':
        """
        Return the attitude at a time near stamp_ns of this one, before or after it.

        As that of a row of a rolling shutter, by rate and acceleration. The covariance is
        P + dt (C + C^T) + dt^2 P_rate with C = cross_covariance; where that is not known it is the
        bound (1 + k) P + (1 + 1 / k) dt^2 P_rate, which holds for any, with the k of least trace.
        An error a of the acceleration adds (a dt^2 / 2)^2 after the frame.
        """
        stamp_ns = checked_stamp(stamp_ns)
        dt_s = (stamp_ns - self.stamp_ns) * 1e-9
        change = (self.shown_rad_s2 + self.jerk_rad_s3 * (dt_s / 2)) * dt_s
        turn = quaternion_from_rotation_vector((
            self.rate_rad_s + self.shown_rad_s2 * (dt_s / 2)
            + self.jerk_rad_s3 * (dt_s ** 2 / 6)) * dt_s)
        by_rate = dt_s ** 2 * self.rate_covariance
        covariance, cross = self.covariance_sensor, self.cross_covariance
        if cross is not None:
            covariance = covariance + dt_s * (cross + cross.T) + by_rate
            cross = cross + dt_s * self.rate_covariance
        elif by_rate.any():
            own, other = np.sqrt([np.trace(covariance), np.trace(by_rate)])
            covariance = (1 + other / own) * covariance + (1 + own / other) * by_rate
        # The error is about axes that turn with the sensor.
        turned = matrix_from_quaternion(turn).T
        moved = (self.acceleration_rad_s2 if dt_s > 0 else self.before_rad_s2) * dt_s
        return replace(
            self, stamp_ns=stamp_ns, quaternion=multiply(self.quaternion, turn),
            covariance_sensor=(turned @ covariance @ turned.T
                               + np.diag((moved * dt_s / 2) ** 2)),
            rate_rad_s=self.rate_rad_s + change,
            shown_rad_s2=self.shown_rad_s2 + self.jerk_rad_s3 * dt_s,
            rate_covariance=self.rate_covariance + np.diag(moved ** 2),
            cross_covariance=None if cross is None else turned @ cross,
            protection_rad=self.protection_rad if dt_s == 0 else np.full(3, np.inf),
            budget=self.budget if dt_s == 0 else None)


@dataclass(frozen=True)
class FrameResult:
    """
    The result of one frame. Its arrays are its own: later frames do not change them.

    centroids are those found or given; identification is None where the frame needed none; tracks
    are empty unless state is TRACKING, and tracked is the attitude that goes with them. attitude
    is None where that cannot be trusted: reason says why, and is empty otherwise. aberration is
    what the attitude is corrected for (full, earth_only, none), with why that is less than asked
    for, such as stamps that are not UTC; empty for a frame that was not used.
    """

    stamp_ns: int
    centroids: Centroids
    identification: Identification | None
    tracks: Tracks
    tracked: TrackedAttitude | None
    attitude: Attitude | None
    state: TrackerState
    reason: str
    aberration: str = ''
