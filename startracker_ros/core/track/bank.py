# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All tracks of a tracker as one table, a column per quantity."""

from dataclasses import dataclass, fields
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.compiled import compiled
from startracker_ros.core.track.association import most_probable
from startracker_ros.core.track.motion_models import POSITION
from startracker_ros.core.track.tracks import Tracks


@dataclass(frozen=True)
class TrackBank:
    """
    Tracks in the order in which they were started.

    track_id (N,); star_index (N,) into the OnboardCatalog; state (N, 4) and covariance
    (N, 4, 4) as in motion_models; variance (N,) px^2 per axis of the last centroid seen;
    confirmed (N,) bool; age and missed (N,) in frames; the rest (N,) as in Tracks.
    """

    track_id: np.ndarray
    star_index: np.ndarray
    state: np.ndarray
    covariance: np.ndarray
    variance: np.ndarray
    confirmed: np.ndarray
    age: np.ndarray
    missed: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray
    residual_px: np.ndarray
    probability: np.ndarray

    def __len__(self) -> int:
        return len(self.star_index)

    @classmethod
    def started(cls, track_id: np.ndarray, star_index: np.ndarray, centroids: Centroids,
                variance: np.ndarray, state: np.ndarray, covariance: np.ndarray,
                confirmed: bool) -> 'TrackBank':
        """Return new tracks (N,) of one centroid each, of variance (N,) px^2 per axis."""
        count = len(star_index)
        zero = np.zeros(count, int)
        return cls(track_id, star_index, state, covariance, variance, np.full(count, confirmed),
                   zero, zero, centroids.flux, centroids.snr, centroids.sigma_px,
                   np.full(count, np.nan), np.ones(count))

    @classmethod
    def empty(cls) -> 'TrackBank':
        """Return a bank without tracks."""
        none = np.empty(0, int)
        return cls.started(none, none, Centroids.empty(), np.empty(0), np.empty((0, 4)),
                           np.empty((0, 4, 4)), False)

    @property
    def uv(self) -> np.ndarray:
        """Positions (N, 2) in px."""
        return self.state[:, POSITION]

    @property
    def uv_covariance(self) -> np.ndarray:
        """Covariances (N, 2, 2) of uv in px^2."""
        return self.covariance[:, ::2, ::2]

    @property
    def sigma_uv(self) -> np.ndarray:
        """Return the 1-sigma errors (N,) of uv in px per axis, the mean of both axes."""
        return np.sqrt((self.covariance[:, 0, 0] + self.covariance[:, 2, 2]) / 2)

    @property
    def detected(self) -> np.ndarray:
        """Return True (N,) for confirmed tracks that had a centroid in the last frame."""
        return self.confirmed & (self.missed == 0)

    def select(self, chosen: np.ndarray) -> 'TrackBank':
        """Return the tracks of a boolean mask (N,)."""
        if chosen.all():
            return self
        return TrackBank(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def joined(self, other: 'TrackBank') -> 'TrackBank':
        """Return these tracks followed by the others."""
        return TrackBank(*(np.concatenate([getattr(self, field.name), getattr(other, field.name)])
                           for field in fields(self)))

    def associated(self, predicted: np.ndarray, probability: np.ndarray, centroids: Centroids,
                   variance: np.ndarray, state: np.ndarray, covariance: np.ndarray) -> 'TrackBank':
        """
        Return the tracks in another state, with their most probable centroids of a frame.

        predicted (N, 2) px; variance (M,) that of the centroids; probability (N, M + 1) as of
        joint_probabilities. A track counts as missed when that is more probable than not.
        """
        return self.with_association(state, covariance, associated_columns(
            self.variance, self.missed, np.ascontiguousarray(predicted), probability,
            np.ascontiguousarray(centroids.uv), variance, centroids.flux, centroids.snr,
            centroids.sigma_px))

    def with_association(self, state: np.ndarray, covariance: np.ndarray,
                         columns: 'Association') -> 'TrackBank':
        """Return the tracks a frame later, in another state, with other columns."""
        variance, missed, *measured = columns
        return TrackBank(self.track_id, self.star_index, state, covariance, variance,
                         self.confirmed, self.age + 1, missed, *measured)

    def to_tracks(self, onboard: OnboardCatalog, identified: bool) -> Tracks:
        """Return the tracks for publication; unless identified, without hip and magnitude."""
        hip, magnitude, uv, velocity, covariance, track_id, age, missed = _published(
            onboard.hip, onboard.magnitude, identified, self.star_index, self.confirmed,
            self.state, self.covariance, self.track_id, self.age, self.missed)
        return Tracks(hip, magnitude, uv, self.flux, self.snr, self.sigma_px, self.residual_px,
                      track_id, age, missed, self.probability, velocity, covariance)


@compiled
def _published(catalog_hip: np.ndarray, catalog_magnitude: np.ndarray, identified: bool,
               star_index: np.ndarray, confirmed: np.ndarray, state: np.ndarray,
               covariance: np.ndarray, track_id: np.ndarray, age: np.ndarray, missed: np.ndarray
               ) -> tuple[np.ndarray, ...]:
    """Return the columns of Tracks that a bank has in another form or type."""
    count = len(star_index)
    hip, magnitude = np.zeros(count, np.int32), np.full(count, np.nan)
    for n in range(count):
        if identified and confirmed[n]:
            hip[n], magnitude[n] = catalog_hip[star_index[n]], catalog_magnitude[star_index[n]]
    return (hip, magnitude, state[:, ::2].copy(), state[:, 1::2].copy(),
            covariance[:, ::2, ::2].copy(), track_id.astype(np.uint32),
            np.minimum(age, 65535).astype(np.uint16), missed.astype(np.uint8))


class Association(NamedTuple):
    """The columns of a TrackBank that an association changes."""

    variance: np.ndarray
    missed: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    sigma_px: np.ndarray
    residual_px: np.ndarray
    probability: np.ndarray


@compiled
def associated_columns(variance: np.ndarray, missed: np.ndarray, predicted: np.ndarray,
                       probability: np.ndarray, uv: np.ndarray, uv_variance: np.ndarray,
                       flux: np.ndarray, snr: np.ndarray, sigma_px: np.ndarray) -> Association:
    """Return the columns after an association, by the arguments of TrackBank.associated()."""
    count, best = len(missed), most_probable(probability)
    after = Association(
        variance.copy(), missed + 1, np.full(count, np.nan), np.full(count, np.nan),
        np.full(count, np.nan), np.full(count, np.nan), np.zeros(count))
    for track in range(count):
        centroid = best[track]
        if len(uv):
            after.probability[track] = probability[track, centroid + 1]
        if probability[track, 0] > 0.5:
            continue
        after.variance[track], after.missed[track] = uv_variance[centroid], 0
        after.flux[track], after.snr[track] = flux[centroid], snr[centroid]
        after.sigma_px[track] = sigma_px[centroid]
        after.residual_px[track] = math.hypot(
            uv[centroid, 0] - predicted[track, 0], uv[centroid, 1] - predicted[track, 1])
    return after
