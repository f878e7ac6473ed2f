# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What one image shows: its stars, attitude and camera."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.maths.rotation import ARCSEC, pointing_from_quaternion
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping

MIN_STARS = 4


@dataclass(frozen=True)
class Solution:
    """
    What one image shows.

    camera has the fitted lens where identified, lens_px its error per axis; sky is None unless
    identified, and bodies, which are no centroids of it, are known only then. For an uncalibrated
    camera +z of the attitude is the middle of the image, else the optical axis of the camera.
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
        """q_icrf_from_sensor (4,), None without an attitude."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.quaternion

    @property
    def covariance_sensor(self) -> np.ndarray | None:
        """Covariance (3, 3) rad^2 of a rotation vector about sensor axes, or None."""
        attitude = self.identification.attitude
        return None if attitude is None else attitude.covariance_sensor

    @property
    def ra_deg(self) -> float:
        """Right ascension of +z of the sensor, NaN without an attitude."""
        return self._pointing_deg[0]

    @property
    def dec_deg(self) -> float:
        """Declination of +z of the sensor, NaN without an attitude."""
        return self._pointing_deg[1]

    @property
    def roll_deg(self) -> float:
        """Position angle of image up, from celestial north through east; NaN without attitude."""
        return self._pointing_deg[2]

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view of the camera with its distortion, NaN without an attitude."""
        return float(np.degrees(self.camera.seen_x_rad)) if self.solved else float('nan')

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
        ra_deg, dec_deg, roll_deg = np.degrees(pointing_from_quaternion(self.quaternion))
        return float(ra_deg), float(dec_deg), float(roll_deg)
