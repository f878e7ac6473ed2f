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
    ARCSEC, matrix_from_quaternion, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.core.track.tracks import Acceleration, TrackedAttitude, Tracks
from startracker_ros.core.values import Summarised


@dataclass(frozen=True, kw_only=True)
class Attitude(AttitudeEstimate):
    """
    The attitude of the sensor in ICRF at a time, with rate and covariance; arrays are float64.

    Attributes:
        quaternion: (4,) q_icrf_from_sensor in the order x, y, z, w: v_icrf = R(q) v_sensor.
        covariance_sensor: (3, 3) rad^2, of the error as a rotation vector about sensor axes.
        stars: Number of stars in the fit.
        residual_rad: (N,) angle between each star and its catalogue direction, rad.
        chi2: Sum of the squares of residual over sigma.
        budget: Contributions to the covariance (ErrorBudget), None where they are not known.
        stamp_ns: UNIX time in ns, int.
        rate_rad_s: (3,) angular velocity with respect to ICRF on sensor axes, rad/s.
        rate_covariance: (3, 3) rad^2/s^2, of the rate.
        cross_covariance: (3, 3) rad^2/s, of the errors of attitude (rows) and rate (columns);
            None where it is not known.
        shown_rad_s2: (3,) angular acceleration that the frames show, rad/s^2, sensor axes.
        jerk_rad_s3: (3,) its rate of change, rad/s^3.
        acceleration_rad_s2: (3,) 1 sigma error of the acceleration after the frame, rad/s^2.
        before_rad_s2: (3,) 1 sigma error of the acceleration before the frame, rad/s^2.
        protection_rad: (3,) bound of the errors about sensor axes, rad, exceeded with
            misleading_probability; infinite without a bound, and in results of `at()`.

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
        """Covariance (3, 3) rad^2 of the error as a rotation vector about ICRF axes."""
        return covariance_icrf(self.quaternion, self.covariance_sensor)

    def at(self, stamp_ns: int) -> 'Attitude':
        """
        Propagate the attitude to a time before or after the frame, by rate and acceleration.

        The covariance is P + dt (C + C^T) + dt^2 P_rate with C = `cross_covariance`; where that
        is not known it is the bound (1 + k) P + (1 + 1 / k) dt^2 P_rate, which holds for any C,
        with the k of least trace. An error a of the acceleration adds (a dt^2 / 2)^2.

        Args:
            stamp_ns: UNIX time in ns, int.

        Returns:
            `Attitude` at that time, without protection level and error budget.

        Raises:
            ValueError: A stamp that is not an int.

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


@dataclass(frozen=True, repr=False)
class FrameResult(Summarised):
    """
    The result of one frame. Its arrays are its own: later frames do not change them.

    Attributes:
        stamp_ns: UNIX time in ns, int, of the frame.
        centroids: Detections found or given (`Centroids`).
        identification: `Identification`, None where the frame needed none.
        tracks: Filtered stars (Tracks), empty unless the state is TRACKING.
        tracked: Attitude of the tracks, trusted or not; None without one.
        attitude: Trusted `Attitude` of the sensor in ICRF, None without one.
        state: `'LOST'`, `'ACQUIRING'` or `'TRACKING'`.
        reason: Why there is no attitude; empty with one.
        aberration: What the attitude is corrected for (full, earth_only, none), and why that is
            less than asked for; empty for a frame that was not used.

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

    def summary(self) -> dict[str, str]:
        """Return the figures of repr()."""
        figures = {'stamp_ns': str(self.stamp_ns), 'state': repr(str(self.state)),
                   'centroids': str(len(self.centroids)), 'tracks': str(len(self.tracks))}
        if self.attitude is None:
            return figures | {'attitude': 'None', 'reason': repr(self.reason)}
        sigma = np.sqrt(np.diag(self.attitude.covariance_sensor)) / ARCSEC
        return figures | {
            name: np.array2string(value, precision=digits, separator=', ')
            for name, value, digits in (('quaternion', self.attitude.quaternion, 6),
                                        ('sigma_sensor_arcsec', sigma, 2))}
