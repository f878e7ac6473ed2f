# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the state machine needs of a model of the motion of stars."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.error_budget import ErrorBudget, NO_ERROR
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import Lens
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.consistency import Residuals
from startracker_ros.core.integrity.systematic_errors import systematic_covariance
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.track.association import DetectionModel, gate_size
from startracker_ros.core.track.bank import TrackBank
from startracker_ros.core.track.motion_models import moved_by
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rotation_fit import RotationFit
from startracker_ros.core.track.start import Start
from startracker_ros.core.track.tracks import Acceleration, TrackedAttitude

_NO_TRACKS = TrackBank.empty()


def rate_between(before_ns: int, before: AttitudeEstimate, after_ns: int,
                 after: AttitudeEstimate) -> np.ndarray:
    """Return the mean body rate (3,) rad/s about sensor axes between two attitudes."""
    turn = attitude_error(after.quaternion, before.quaternion)
    return turn / ((after_ns - before_ns) * 1e-9)


@dataclass(frozen=True)
class FrameUpdate:
    """
    The result of a frame: good when enough stars agree on an attitude within the limits.

    fit has a row for each track of the bank, None where no stars agree on an attitude; frame are
    the M centroids at its time, unassociated (M,) masks those in no gate; residuals are those of
    the detected stars of a model that has them.
    """

    good: bool
    fit: RotationFit | None
    frame: Centroids
    unassociated: np.ndarray
    residuals: Residuals | None = None


class StarModel(ABC):
    """
    Predicts the tracked stars, and updates them by frames of centroids.

    bank holds the tracks; from the start on rate_rad_s (3,) and rate_covariance (3, 3) are the
    body rate. uses_gyro is whether gyro rates are used, gyro_trouble why they are not. failure is
    why the state is no longer to be used, empty while it is.
    """

    gyro_trouble = failure = ''
    uses_gyro = False
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray

    def __init__(self, camera: Camera, options: TrackerOptions) -> None:
        self._camera = camera
        self._options = options
        self._detection = DetectionModel(
            gate_size(options.gate_probability), options.gate_probability,
            options.detection_probability, float(camera.width * camera.height))
        self.bank = _NO_TRACKS

    def set_limits(self, options: TrackerOptions) -> None:
        """Use live options; the others must be those of before."""
        self._options = options

    @abstractmethod
    def start(self, start: Start) -> None:
        """Begin at the identified frame of a start with its rate, without tracks."""

    def resume(self, before: 'StarModel') -> None:  # noqa: B027  # only one model has any
        """Use what a model before the start has learnt of the motion, where it did."""

    @property
    def predicted(self) -> TrackedAttitude | None:
        """Return the attitude at the last frame, good or not, of a model that has one."""
        return None

    @property
    def measured_attitude(self) -> AttitudeEstimate | None:
        """Return the attitude by the stars of the last good frame alone, of a model with one."""
        return None

    @property
    def cross_covariance(self) -> np.ndarray | None:
        """Return that (3, 3) of the errors of attitude and rate, of a model that knows it."""
        return None

    @property
    def acceleration(self) -> Acceleration:
        """Return the angular acceleration at the last frame."""
        return Acceleration(np.zeros(3), self._options.acceleration_rad_s2, *[np.zeros(3)] * 2)

    @property
    def lens(self) -> Lens:
        """Return the lens that the stars are predicted with."""
        return self._camera.lens

    @property
    def lens_error_px(self) -> float:
        """Return the error of star positions that stays from frame to frame, where it is known."""
        return 0.0

    @property
    def lens_scale(self) -> float:
        """Return the 1 sigma of the relative error of the distances from the axis."""
        return 0.0

    @property
    def stamp_sigma_s(self) -> float:
        """Return the standard deviation of the stamps, where it is known."""
        return 0.0

    @property
    def stamp_turn_rad(self) -> np.ndarray:
        """Return the turn (3,) about sensor axes in that time."""
        return np.zeros(3)

    @abstractmethod
    def update(self, stamp_ns: int, frame: Centroids, sky: ApparentCatalog) -> FrameUpdate:
        """Predict the tracks to the time of a newer frame, of this sky, and update them by it."""

    def add(self, track_id: np.ndarray, star_index: np.ndarray, centroids: Centroids, *,
            confirmed: bool) -> None:
        """Add tracks (N,) of stars at these centroids, which move with the body rate."""
        variance = self.sigma_px(centroids) ** 2
        added = TrackBank.started(track_id, star_index, centroids, variance, *moved_by(
            self._camera.lens, *map(np.ascontiguousarray, (
                centroids.uv, variance, self.rate_rad_s, self.rate_covariance))), confirmed)
        self.bank = self.bank.joined(added) if len(self.bank) else added

    def budget(self, own: np.ndarray, velocity_sigma_m_s: float) -> ErrorBudget:
        """
        Return the errors of an attitude of the last frame, of which the filter has own (3, 3).

        velocity_sigma_m_s is the 1 sigma of the unknown velocity of the observer per axis.
        """
        by_velocity = by_lens = NO_ERROR
        if velocity_sigma_m_s or self.lens_error_px or self.lens_scale:
            bank = self.bank
            by_velocity, by_lens = systematic_covariance(
                self._camera.lens, self._camera.pixel_rad, bank.state, bank.variance,
                bank.detected, float(velocity_sigma_m_s), self.lens_error_px, self.lens_scale)
        return ErrorBudget(own, stamps=np.outer(self.stamp_turn_rad, self.stamp_turn_rad),
                           lens=by_lens, observer=by_velocity)

    def sigma_px(self, centroids: Centroids) -> np.ndarray:
        """Return the 1-sigma errors (M,) of centroids per axis, at least sigma_floor_px."""
        return np.maximum(centroids.sigma_px, self._options.sigma_floor_px)

    def error_px2(self, centroids: Centroids) -> np.ndarray:
        """Return the covariances (M, 2, 2) of centroids, no axis below sigma_floor_px."""
        return floored(np.ascontiguousarray(centroids.covariance),
                       self._options.sigma_floor_px ** 2)

    def is_sparse(self, frame: Centroids) -> bool:
        """Return whether a frame holds too few centroids for an attitude."""
        return len(frame) < self._options.min_stars


@compiled
def floored(covariance: np.ndarray, floor: float) -> np.ndarray:
    """Return covariances (M, 2, 2) with variances of at least a floor."""
    error = covariance.copy()
    for i in range(len(error)):
        for axis in range(2):
            error[i, axis, axis] = max(error[i, axis, axis], floor)
    return error
