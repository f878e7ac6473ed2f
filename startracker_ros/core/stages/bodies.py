# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Planets, Moon and Sun in an image, which are not stars."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.bodies import BODIES, BodiesInSky
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.core.stages.sky_mapping import SkyMapping

# Of a spot from the disc of its body.
_MARGIN_PX = 3.0
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

    def in_image(self, mapping: SkyMapping) -> tuple[BodyInImage, ...]:
        """Return the bodies in the image, seen or too faint for it."""
        if self.sky is None or not self.sky.reach(
                matrix_from_quaternion(mapping.quaternion)[:, 2], mapping.reach_rad):
            return ()
        uv, radius_px = mapping.pixels(self.sky.direction), (
            self.sky.radius_rad / mapping.camera.pixel_rad)
        return tuple(
            BodyInImage(BODIES[body], float(uv[body, 0]), float(uv[body, 1]),
                        float(self.sky.magnitude[body]), float(radius_px[body]))
            for body in np.flatnonzero(mapping.camera.contains(uv)))

    def spots(self, mapping: SkyMapping, centroids: Centroids, magnitude: np.ndarray
              ) -> np.ndarray:
        """
        Return which centroids (N,) are bodies.

        magnitude (N,) is that of the identified star of each centroid, NaN for none.
        """
        if self.sky is None:
            return np.zeros(len(centroids), bool)
        near = self.sky.near(mapping.directions(centroids.uv), magnitude,
                             _MARGIN_PX * mapping.camera.pixel_rad, _FAINTER_MAG)
        faintest = np.nanmax(magnitude, initial=-np.inf) + _FAINTER_MAG
        return (near & (self.sky.magnitude < faintest)).any(axis=1)
