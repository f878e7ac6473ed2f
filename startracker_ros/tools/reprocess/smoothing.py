# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Smoothed attitudes of a segment, out of the attitudes of its single frames."""

import numpy as np
from startracker_ros.core.attitude.gyro import MAX_RATE_RAD_S
from startracker_ros.core.attitude.smoothing import MotionNoise, smooth
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector)
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.tools.reprocess.frame_fit import FrameFit
from startracker_ros.tools.reprocess.tables import fill, PAIRS, UPPER

SMOOTHED_DTYPE = np.dtype([
    ('stamp_ns', 'i8'), *((f'q_{axis}', 'f8') for axis in 'xyzw'),
    *((f'cov_{pair}_rad2', 'f8') for pair in PAIRS),
    *((f'rate_{axis}_rad_s', 'f8') for axis in 'xyz'),
    *((f'bias_{axis}_rad_s', 'f8') for axis in 'xyz'),
    *((f'bias_sigma_{axis}_rad_s', 'f8') for axis in 'xyz'),
    *((f'error_{axis}_arcsec', 'f4') for axis in 'xyz')])
"""One row for each frame; bias is NaN without a gyro, error without truth."""

_UNKNOWN = np.full(4, np.nan), np.full(3, np.nan), np.full((3, 3), np.nan)
_LONGEST_GAP_S = 600.0
"""A recording is smoothed in parts on both sides of a longer gap."""

_DEG_H, _DEG_SQRT_H, _HOUR_S = np.radians(1 / 3600), np.radians(1 / 60), 3600.0


class Smoothing:
    """Collects the frames and gyro rates of a segment and of the overlap on both its sides."""

    def __init__(self, options: StarTrackerOptions) -> None:
        self._options = options
        self._stamps: list[int] = []
        self._wanted: list[bool] = []
        self._with_gyro: list[bool] = []
        self._tracked: list[np.ndarray] = []
        self._turn: list[np.ndarray] = []
        self._covariance: list[np.ndarray] = []
        self._truth: list[np.ndarray] = []
        self._rates: list[tuple[int, np.ndarray]] = []

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> None:
        """Add a rate (3,) about sensor axes measured up to a time."""
        if np.isfinite(rate_rad_s).all() and np.abs(rate_rad_s).max() <= MAX_RATE_RAD_S:
            self._rates.append((stamp_ns, rate_rad_s))

    def add(self, stamp_ns: int, quaternion: np.ndarray | None, fit: FrameFit | None,
            truth: np.ndarray | None, *, uses_gyro: bool, wanted: bool) -> None:
        """
        Add a frame: its attitude and the fit about it; wanted if its row is to be returned.

        uses_gyro is whether the star tracker found that the gyro agrees with the stars.
        """
        if self._stamps and stamp_ns <= self._stamps[-1]:
            return
        tracked, turn, covariance = _UNKNOWN
        if quaternion is not None and fit is not None:
            tracked, turn, covariance = quaternion, fit.turn_rad, fit.covariance
            self._with_gyro.append(uses_gyro)
        self._stamps.append(stamp_ns)
        self._wanted.append(wanted)
        self._tracked.append(tracked)
        self._turn.append(turn)
        self._covariance.append(covariance)
        self._truth.append(_UNKNOWN[0] if truth is None else truth)

    def table(self) -> np.ndarray:
        """Return the smoothed rows of the wanted frames."""
        stamp_ns = np.array(self._stamps, np.int64)
        known = np.flatnonzero(np.isfinite(np.array(self._tracked).reshape(-1, 4)[:, 0]))
        if not len(known):
            return np.empty(0, SMOOTHED_DTYPE)
        parts = np.split(known, 1 + np.flatnonzero(
            np.diff(stamp_ns[known]) > _LONGEST_GAP_S * 1e9))
        return np.concatenate([self._part(stamp_ns, int(part[0]), int(part[-1]) + 1)
                               for part in parts])

    def _part(self, stamps: np.ndarray, begin: int, end: int) -> np.ndarray:
        """Return the rows of frames from begin to end, both measured."""
        stamp_ns, chosen = stamps[begin:end], slice(begin, end)
        gyro = self._mean_rates(stamp_ns)
        measured = multiply(np.array(self._tracked[chosen]),
                            quaternion_from_rotation_vector(np.array(self._turn[chosen])))
        found = smooth(stamp_ns, measured, np.array(self._covariance[chosen]),
                       self._noise(stamp_ns), gyro)
        wanted = np.flatnonzero(self._wanted[chosen])
        rows = np.zeros(len(wanted), SMOOTHED_DTYPE)
        rows['stamp_ns'] = stamp_ns[wanted]
        covariance = found.covariance[wanted]
        attitude = covariance[:, :3, :3]
        fill(rows, 'q_{}', 'xyzw', found.quaternion[wanted].T)
        fill(rows, 'cov_{}_rad2', PAIRS, attitude[:, UPPER[0], UPPER[1]].T)
        fill(rows, 'rate_{}_rad_s', 'xyz', found.rate_rad_s[wanted].T)
        unknown = np.full((3, len(wanted)), np.nan)
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 6:]).T
        fill(rows, 'bias_{}_rad_s', 'xyz', unknown if gyro is None else found.bias_rad_s[wanted].T)
        fill(rows, 'bias_sigma_{}_rad_s', 'xyz', unknown if gyro is None else sigma)
        error = attitude_error(found.quaternion[wanted], np.array(self._truth[chosen])[wanted])
        fill(rows, 'error_{}_arcsec', 'xyz', error.T / ARCSEC)
        return rows

    def _mean_rates(self, stamp_ns: np.ndarray) -> np.ndarray | None:
        """Return the mean rate (N, 3) since the frame before, None if the gyro is not used."""
        if not self._rates or len(stamp_ns) < 2 or np.mean(self._with_gyro) < 0.5:
            return None
        times = np.array([stamp for stamp, _ in self._rates])
        order = np.argsort(times, kind='stable')
        sums = np.vstack([np.zeros(3), np.cumsum(
            np.array([rate for _, rate in self._rates])[order], axis=0)])
        at = np.searchsorted(times[order], stamp_ns, side='right')
        with np.errstate(invalid='ignore'):
            return np.vstack([np.full(3, np.nan), np.diff(sums[at], axis=0)
                              / np.diff(at)[:, None]])

    def _noise(self, stamp_ns: np.ndarray) -> MotionNoise:
        """Return the noise that the options of star tracker and gyro state."""
        gyro, tracker = self._options.gyro, self._options.tracker
        interval_s = float(np.median(np.diff(stamp_ns))) * 1e-9 if len(stamp_ns) > 1 else 1.0
        across, roll = tracker.acceleration_deg_s2, tracker.roll_acceleration_deg_s2
        drift = gyro.gyro_drift_deg_h * _DEG_H
        return MotionNoise(np.radians([across, across, roll]) ** 2 * interval_s,
                           (gyro.gyro_noise_deg_sqrt_h * _DEG_SQRT_H) ** 2,
                           drift ** 2 / _HOUR_S, drift)
