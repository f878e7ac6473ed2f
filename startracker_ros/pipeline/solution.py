"""What one image shows: its stars, attitude and camera."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.identification import Identification
from startracker_ros.pipeline.bodies import BodyInImage
from startracker_ros.pipeline.sky_mapping import SkyMapping

MIN_STARS = 4


@dataclass(frozen=True)
class Solution:
    """
    What one image shows.

    camera has the fitted lens where identified, lens_px its error per axis; sky is None unless
    identified, and bodies, which are no centroids of it, are known only then. For an uncalibrated
    camera +z of the attitude is the middle of the image, else the optical axis of the camera.
    """

    centroids: Centroids
    identification: Identification
    camera: Camera
    lens_px: float = float('nan')
    sky: SkyMapping | None = None
    bodies: tuple[BodyInImage, ...] = ()

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
