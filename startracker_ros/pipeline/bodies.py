"""Planets, Moon and Sun in an image, which are no stars."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.astro.bodies import BODIES, BodiesInSky
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.maths.rotation import ARCSEC
from startracker_ros.pipeline.sky_mapping import SkyMapping

_ERROR_RAD, _LEAST_PX = 60 * ARCSEC, 3.0
# A body that is fainter than a star at its position is not what is seen there; one that is fainter
# than all stars of the image is not seen.
_FAINTER_MAG = 1.0


class BodyInImage(NamedTuple):
    """Name, pixel, V and radius of a body."""

    name: str
    u: float
    v: float
    magnitude: float
    radius_px: float


@dataclass(frozen=True)
class Bodies:
    """The bodies at the time of an image, None where its hour is unknown."""

    sky: BodiesInSky | None = None

    def in_image(self, mapping: SkyMapping, centroids: Centroids, magnitude: np.ndarray
                 ) -> tuple[tuple[BodyInImage, ...], np.ndarray]:
        """
        Return the bodies in the image, and which centroids (N,) they are.

        magnitude (N,) is that of the identified star of each centroid, NaN for none.
        """
        spots = np.zeros(len(centroids), bool)
        if self.sky is None:
            return (), spots
        pixel_rad = mapping.camera.pixel_rad
        uv, radius_px = mapping.pixels(self.sky.direction), self.sky.radius_rad / pixel_rad
        gate_px = radius_px + max(_ERROR_RAD / pixel_rad, _LEAST_PX)
        faintest = np.nanmax(magnitude, initial=-np.inf) + _FAINTER_MAG
        found = []
        for body in np.flatnonzero(mapping.camera.contains(uv)):
            v = float(self.sky.magnitude[body])
            distance_px = np.linalg.norm(centroids.uv - uv[body], axis=1)
            # Brightest first.
            near = np.flatnonzero((distance_px < gate_px[body])
                                  & ~(magnitude < v - _FAINTER_MAG))
            near = near if radius_px[body] > _LEAST_PX else near[:1]
            spots[near] |= v < faintest
            found.append(BodyInImage(BODIES[body], float(uv[body, 0]), float(uv[body, 1]), v,
                                     float(radius_px[body])))
        return tuple(found), spots
