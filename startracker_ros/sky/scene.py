"""Which stars fall into the image, and where."""

from dataclasses import dataclass

import numpy as np

from startracker_ros.camera import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.rotation import matrix_from_quaternion


@dataclass(frozen=True)
class SceneStars:
    """Stars in and around an image, brightest first.

    hip (N,) int32, uv (N, 2) in px, magnitude (N,) V. Close pairs stay apart: their images
    blend on the detector as they do in the sky.
    """

    hip: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        """Return the number of stars."""
        return len(self.hip)

    def select(self, chosen: np.ndarray) -> 'SceneStars':
        """Return the stars of a boolean mask (N,) or of indices."""
        return SceneStars(self.hip[chosen], self.uv[chosen], self.magnitude[chosen])


def visible_stars(catalog: StarCatalog, directions: np.ndarray, camera: Camera,
                  q_icrf_from_sensor: np.ndarray, margin_px: float = 0.0) -> SceneStars:
    """Return the stars in the image and up to margin_px beyond its edges.

    directions (N, 3): unit vectors to the stars of the catalogue, ICRF axes.
    """
    matrix = matrix_from_quaternion(q_icrf_from_sensor)
    # Only stars near the field are projected: the distortion model means nothing elsewhere.
    # Twice the nominal angle of the margin leaves room for distortion.
    radius_rad = camera.corner_angle_rad + 2 * margin_px * camera.pixel_rad
    near = np.flatnonzero(directions @ matrix[:, 2] >= np.cos(radius_rad))
    uv = camera.project(directions[near] @ matrix)
    seen = camera.contains(uv, -margin_px)
    near = near[seen]
    return SceneStars(catalog.hip[near], uv[seen], catalog.magnitude[near])
