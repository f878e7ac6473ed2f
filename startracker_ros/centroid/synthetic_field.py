"""A field without an image: the centroids of catalogue stars, exact, for warm-ups and checks."""

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import OnboardCatalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.maths.rotation import conjugate, quaternion_from_pointing, rotate

# Orion: bright stars for narrow fields and wide ones.
_RA_RAD, _DEC_RAD, _ROLL_RAD = np.radians([84.0, 0.0, 30.0])
_SIGMA_PX = 0.1


def synthetic_field(onboard: OnboardCatalog, camera: Camera) -> tuple[Centroids, np.ndarray]:
    """Return the centroids of the stars that a camera sees in Orion, and their hip (N,)."""
    q = quaternion_from_pointing(_RA_RAD, _DEC_RAD, _ROLL_RAD)
    star = onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    uv = camera.project(rotate(conjugate(q), onboard.direction[star]))
    seen = camera.contains(uv)
    star, uv = star[seen], uv[seen]
    flux = 1e6 * 10 ** (-0.4 * onboard.magnitude[star])
    return (Centroids(uv, flux, np.full(len(star), 1 / _SIGMA_PX),
                      np.full(len(star), _SIGMA_PX)), onboard.hip[star])
