# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tracked stars of one frame, their common attitude, and one from elsewhere."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.result import AttitudeEstimate


_COVARIANCE = (4, 5, 5, 6)  # columns of a STAR_TRACK


@dataclass(frozen=True)
class Tracks:
    """
    Filtered star images of one frame, in the order in which they were started.

    hip (N,) int32, 0 while the star is not confirmed; magnitude (N,) of the
    catalogue, NaN where hip is 0; uv (N, 2) px, filtered; flux (N,) DN, snr (N,) and sigma_px
    (N,) of the centroid, NaN when missed; residual_px (N,) the distance of the centroid from
    its prediction, NaN when missed or just started; track_id (N,) uint32, unique;
    age (N,) uint16 frames since start; missed (N,) uint8 frames since the last detection;
    association_probability (N,) of the most probable centroid; velocity (N, 2) px/s;
    covariance (N, 2, 2) px^2 of uv.
    """

    hip: np.ndarray
    magnitude: np.ndarray
    uv: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray
    residual_px: np.ndarray
    track_id: np.ndarray
    age: np.ndarray
    missed: np.ndarray
    association_probability: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray

    def __len__(self) -> int:
        return len(self.hip)

    @classmethod
    def empty(cls) -> 'Tracks':
        """Return a list without tracks."""
        none = np.empty(0)
        return cls(
            hip=np.empty(0, np.int32), magnitude=none, uv=np.empty((0, 2)), flux=none, snr=none,
            sigma_px=none, residual_px=none, track_id=np.empty(0, np.uint32),
            age=np.empty(0, np.uint16), missed=np.empty(0, np.uint8),
            association_probability=none, velocity=np.empty((0, 2)),
            covariance=np.empty((0, 2, 2)))

    @classmethod
    def of(cls, table: np.ndarray) -> 'Tracks':
        """Return the tracks of a table (N,) of STAR_TRACK, which they are views of."""
        columns = table.view(float).reshape(len(table), table.itemsize // 8)
        tracks = cls(
            hip=table['hip'], magnitude=columns[:, 7], uv=columns[:, :2], flux=columns[:, 8],
            snr=columns[:, 9], sigma_px=columns[:, 10], residual_px=columns[:, 11],
            track_id=table['track_id'], age=table['age'].astype(np.uint16),
            missed=table['missed'].astype(np.uint8), association_probability=columns[:, 13],
            velocity=columns[:, 2:4], covariance=columns[:, _COVARIANCE].reshape(-1, 2, 2))
        vars(tracks)['_table'] = table
        return tracks

    def table(self) -> np.ndarray:
        """Return a table (N,) of STAR_TRACK of these tracks."""
        if '_table' in vars(self):
            return vars(self)['_table']
        table = np.zeros(len(self), native.STAR_TRACK)
        columns = table.view(float).reshape(len(table), table.itemsize // 8)
        columns[:, :2], columns[:, 2:4] = self.uv, self.velocity
        columns[:, 4], columns[:, 5], columns[:, 6] = (
            self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1])
        columns[:, 7], columns[:, 8], columns[:, 9] = self.magnitude, self.flux, self.snr
        columns[:, 10], columns[:, 11], columns[:, 12] = (
            self.sigma_px, self.residual_px, np.nan)
        columns[:, 13] = self.association_probability
        for name in ('hip', 'track_id', 'age', 'missed'):
            table[name] = getattr(self, name)
        return table

    @property
    def usable(self) -> np.ndarray:
        """Return True (N,) for confirmed stars detected in this frame, fit for an attitude."""
        return (self.hip > 0) & (self.missed == 0)

    @property
    def position_sigma_px(self) -> np.ndarray:
        """Return the 1-sigma error (N,) of uv per axis, the mean of both axes."""
        return np.sqrt((self.covariance[:, 0, 0] + self.covariance[:, 1, 1]) / 2)


@dataclass(frozen=True)
class TrackedAttitude:
    """
    The filtered attitude and body rate of a frame whose stars agree.

    rate_rad_s (3,) about sensor axes and its covariance (3, 3).
    """

    attitude: AttitudeEstimate
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray


class Acceleration(NamedTuple):
    """
    How attitude and rate go on, about sensor axes, each (3,).

    mean in rad/s^2 and jerk in rad/s^3 are those of a cubic turn; sigma is the 1 sigma of the
    acceleration after the frame, before that before it, without the errors of attitude and rate.
    """

    mean: np.ndarray
    sigma: np.ndarray
    jerk: np.ndarray
    before: np.ndarray


class Hint(NamedTuple):
    """
    An attitude from elsewhere: from other heads, or a gyro.

    quaternion (4,) is q_icrf_from_sensor with its covariance (3, 3) rad^2; rate (3,) rad/s with
    its covariance (3, 3); all about sensor axes.
    """

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray
    rate: np.ndarray
    rate_covariance: np.ndarray
