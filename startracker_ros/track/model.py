"""What the state machine asks of a model of the motion of stars."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.maths.rotation import attitude_error
from startracker_ros.track.association import Chances, gate_size
from startracker_ros.track.bank import TrackBank
from startracker_ros.track.motion_models import image_jacobian
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.rotation_fit import RotationFit


@dataclass(frozen=True)
class Fix:
    """An identified frame that fits the catalogue: its known stars and their attitude."""

    stamp_ns: int
    place: np.ndarray
    centroids: Centroids
    attitude: AttitudeEstimate
    scale: float


def rate_between(before_ns: int, before: AttitudeEstimate, after_ns: int,
                 after: AttitudeEstimate) -> np.ndarray:
    """Return the mean body rate (3,) rad/s about sensor axes between two attitudes."""
    turn = attitude_error(after.quaternion, before.quaternion)
    return turn / ((after_ns - before_ns) * 1e-9)


@dataclass(frozen=True)
class Followed:
    """
    What a frame said: whether its stars agree, on what, and which centroids (M,) are over.

    fit has a row for each track of the bank; it is None where no stars agree on anything.
    """

    good: bool
    fit: RotationFit | None
    unclaimed: np.ndarray


class StarModel(ABC):
    """
    Predicts the followed stars, and takes a frame of centroids.

    bank holds the tracks; from the start on rate_rad_s (3,) and rate_covariance (3, 3) are the
    body rate; uses_gyro says whether a gyro supports it, gyro_trouble why one does not.
    """

    gyro_trouble = ''
    uses_gyro = False
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray

    def __init__(self, camera: Camera, places: StarPlaces, options: TrackerOptions) -> None:
        self._camera = camera
        self._places = places
        self._options = options
        self._chances = Chances(
            gate_size(options.gate_probability), options.gate_probability,
            options.detection_probability, float(camera.width * camera.height))
        self.bank = TrackBank.empty()

    @abstractmethod
    def start(self, fix: Fix, first: Fix) -> None:
        """Begin at a fix with the rate since the first one, and without tracks."""

    @abstractmethod
    def follow(self, stamp_ns: int, frame: Centroids) -> Followed:
        """Bring the tracks to a newer frame."""

    def add(self, track_id: np.ndarray, place: np.ndarray, centroids: Centroids, *,
            confirmed: bool) -> None:
        """Follow more stars (N,), which stand at these centroids and move with the body."""
        jacobian = image_jacobian(self._camera, self._camera.unproject(centroids.uv))
        self.bank = self.bank.joined(TrackBank.started(
            track_id, place, centroids, self.sigma_px(centroids) ** 2, jacobian @ self.rate_rad_s,
            jacobian @ self.rate_covariance @ np.swapaxes(jacobian, 1, 2), confirmed))

    def sigma_px(self, centroids: Centroids) -> np.ndarray:
        """Return the errors (M,) of centroids per axis that are believed."""
        return np.maximum(centroids.sigma_px, self._options.sigma_floor_px)

    def is_dark(self, frame: Centroids) -> bool:
        """Return whether a frame holds too little to say anything about the followed stars."""
        return len(frame) < self._options.min_stars
