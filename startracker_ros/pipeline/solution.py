"""What one image shows: its stars, attitude and camera."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.astro.aberration import apparent_directions, natural_directions, Vantage
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.identification import Identification
from startracker_ros.maths.rotation import matrix_from_quaternion, rotate

MIN_STARS = 4
_BEYOND_CORNER = 1.05


@dataclass(frozen=True)
class SkyMapping:
    """
    Pixels of an image to directions on ICRS axes as the catalogue has them, and back.

    quaternion is q_icrf_from_sensor of the optical axis. With a vantage it was fitted to apparent
    directions; without one to those of the catalogue.
    """

    camera: Camera
    quaternion: np.ndarray
    vantage: Vantage | None = None

    def pixels(self, directions: np.ndarray) -> np.ndarray:
        """Return pixels (N, 2) of unit vectors (N, 3), NaN for those far outside the image."""
        apparent = directions if self.vantage is None else apparent_directions(
            directions, self.vantage)
        sensor = apparent @ matrix_from_quaternion(self.quaternion)
        # Beyond the corners a distortion may fold back into the image.
        beyond = sensor[:, 2] < np.cos(min(_BEYOND_CORNER * self.camera.corner_angle_rad, 1.57))
        return np.where(beyond[:, None], np.nan, self.camera.project(sensor))

    def directions(self, pixels: np.ndarray) -> np.ndarray:
        """Return unit vectors (N, 3) of pixels (N, 2)."""
        apparent = rotate(self.quaternion, self.camera.unproject(pixels))
        return apparent if self.vantage is None else natural_directions(apparent, self.vantage)


@dataclass(frozen=True)
class Solution:
    """
    What one image shows.

    camera has the fitted lens where identified, lens_px its error per axis; sky is None unless
    identified. For an uncalibrated
    camera +z of the attitude is the middle of the image, else the optical axis of the camera.
    """

    centroids: Centroids
    identification: Identification
    camera: Camera
    lens_px: float = float('nan')
    sky: SkyMapping | None = None

    @classmethod
    def none(cls, camera: Camera, centroids: Centroids, status: str, reason: str) -> 'Solution':
        """Return the solution without an attitude; an empty reason is that of too few stars."""
        count = len(centroids)
        if status == 'ok':
            status = 'too_few_stars'
            reason = (f'{count} spots that may be stars, at least {MIN_STARS} are needed: expose '
                      'longer, or take a wider field')
        nothing = Identification(status, reason, np.zeros(count, np.int32),
                                 np.full(count, np.nan), np.full(count, np.nan), None, 1.0, 1.0)
        return cls(centroids, nothing, camera)

    @property
    def quaternion(self) -> np.ndarray | None:
        """q_icrf_from_sensor (4,), None without an attitude."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.quaternion
