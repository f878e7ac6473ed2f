# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What one image shows: its stars, attitude and camera."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.maths.rotation import ARCSEC, multiply, pointing_from_quaternion
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping

MIN_STARS = 4
_FARTHEST_STARS = 1.15  # so much farther than its stars the lens of a fisheye is known


@dataclass(frozen=True)
class Solution:
    """
    What one image shows.

    camera has the fitted lens where identified, lens_px its error per axis; sky is None unless
    identified, and bodies, not centroids of it, are known only then. The attitude is that
    of the sensor axes of camera, +z its optical axis: star directions turned by it and projected
    by camera are the pixels of the stars. Pointing and roll are those of the middle of the image
    where the lens is fitted to it (fitted), else of the optical axis of a calibrated camera.
    dropped is the nominal camera where the image has another field of view. turned_over is whether
    the rows are in the other order than those of the image that was given, a mirrored one.
    """

    centroids: Centroids
    identification: Identification
    camera: Camera
    lens_px: float = float('nan')
    sky: SkyMapping | None = None
    bodies: tuple[BodyInImage, ...] = ()
    dropped: Camera | None = None
    turned_over: bool = False
    fitted: bool = False

    @classmethod
    def none(cls, camera: Camera, centroids: Centroids, status: str, reason: str) -> 'Solution':
        """Return the solution without an attitude; an empty reason is that of too few stars."""
        count = len(centroids)
        if status == 'ok':
            status = 'too_few_stars'
            reason = (f'{count} detections that may be stars, at least {MIN_STARS} are needed: '
                      'expose longer, or take a wider field')
        nothing = Identification(status, reason, np.zeros(count, np.int32),
                                 np.full(count, np.nan), np.full(count, np.nan), None, 1.0, 1.0)
        return cls(centroids, nothing, camera)

    def of_tries(self, count: int) -> 'Solution':
        """Return the solution as that of one of so many searches."""
        found = self.identification
        return replace(self, identification=replace(found, false_alarm_probability=min(
            count * found.false_alarm_probability, 1.0)))

    @property
    def solved(self) -> bool:
        """Return whether there is an attitude."""
        return self.identification.attitude is not None

    @property
    def status(self) -> str:
        """Return 'identified', or what kind of reason there is for no attitude."""
        return self.identification.status

    @property
    def reason(self) -> str:
        """Return why there is no attitude, empty where there is one."""
        return '' if self.solved else self.identification.reason

    @property
    def quaternion(self) -> np.ndarray | None:
        """q_icrf_from_sensor (4,) of the axes of camera, None without an attitude."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.quaternion

    @property
    def covariance_sensor(self) -> np.ndarray | None:
        """Covariance (3, 3) rad^2 of a rotation vector about sensor axes, or None."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.covariance_sensor

    @property
    def ra_deg(self) -> float:
        """Right ascension of the middle of the image, or of a calibrated axis; else NaN."""
        return self._pointing_deg[0]

    @property
    def dec_deg(self) -> float:
        """Declination of the middle of the image, or of a calibrated axis; else NaN."""
        return self._pointing_deg[1]

    @property
    def roll_deg(self) -> float:
        """Position angle of image up, from celestial north through east; NaN without attitude."""
        return self._pointing_deg[2]

    @property
    def fov_deg(self) -> float:
        """
        Horizontal field of view of the camera with its distortion, NaN without an attitude.

        NaN as well for a fisheye whose lens is fitted to stars that are far from these edges: all
        beyond its stars, as the black margin, is extrapolated.
        """
        if not self.solved or self.fitted and self.camera.model.equidistant and self._margin:
            return float('nan')
        return float(np.degrees(self.camera.seen_x_rad))

    @property
    def _margin(self) -> bool:
        """Return whether the left or right edge is outside of the circle or far from stars."""
        camera = self.camera
        edges = np.array([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
        uv = self.centroids.uv[self.identification.hip > 0]
        stars_px = np.hypot(uv[:, 0] - camera.cx, uv[:, 1] - camera.cy).max()
        return bool(np.abs(edges[:, 0] - camera.cx).max() > _FARTHEST_STARS * stars_px
                    or np.isnan(camera.unproject(edges)).any())

    @property
    def matched(self) -> int:
        """Return the number of identified stars."""
        return self.identification.matched

    @property
    def residual_arcsec(self) -> float:
        """Rms angle between stars and their catalogue directions, NaN without an attitude."""
        attitude = self.identification.attitude
        if attitude is None:
            return float('nan')
        return float(np.sqrt(np.mean(attitude.residual_rad ** 2)) / ARCSEC)

    @property
    def false_alarm(self) -> float:
        """Probability that the best candidate is chance."""
        return self.identification.false_alarm_probability

    @property
    def _pointing_deg(self) -> tuple[float, float, float]:
        if self.quaternion is None:
            return float('nan'), float('nan'), float('nan')
        axes = self.quaternion
        if self.fitted:
            axes = multiply(axes, self.camera.middle_axes)
        ra_deg, dec_deg, roll_deg = np.degrees(pointing_from_quaternion(axes))
        return float(ra_deg), float(dec_deg), float(roll_deg)
