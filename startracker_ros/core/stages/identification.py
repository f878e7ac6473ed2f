# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When a frame is identified, and by which method: the identifier with its schedule."""

from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.astro.bodies import bodies_at
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.core.options import option, Options
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.core.track.frame_motion import rate_between_frames
from startracker_ros.core.track.rolling_shutter import at_frame_time, fit_rate


SHEAR_PX = (0.5, 2.0)
"""Errors of position by a rolling shutter that are tried while the rate is unknown."""

_FIELD_MARGIN = 1.1  # of its corner angle, for bodies whose light reaches into the image


@dataclass(frozen=True)
class CheckOptions(Options):
    """How often the tracks are checked against an identification."""

    check_period_s: float = option(
        10.0, 'time between two frames that are identified lost-in-space while the star tracker '
        'tracks, so that it notices that it follows the wrong stars; 0 for never',
        unit='s', low=0.0, high=3600.0)


class IdentificationStage:
    """
    Identifies frames while the star tracker does not follow the stars, and checks its tracks.

    A method that predicts the attitude with the rates of a gyro identifies every frame: only a
    fresh prediction identifies a field of two or three stars. own are options of the method alone.

    Planets, Moon and Sun are not stars: body_spots counts the centroids of the newest identified
    frame that are these.
    """

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 check: CheckOptions = CheckOptions(),
                 own: Options | None = None,
                 gyro: GyroErrorOptions = GyroErrorOptions(),
                 band: BandOptions = BandOptions()) -> None:
        self._check_period_ns = round(check.check_period_s * 1e9)
        self._gyro = gyro
        self.identifier = make_identifier(camera, epoch_year, options, band=band, own=own)
        self.reset()

    def reset(self) -> None:
        """Forget the predicted attitude and when the last frame was identified."""
        self.body_spots = 0
        self._identified_ns: int | None = None
        self._before: tuple[int, Centroids] | None = None
        self._frames = self.identifier.frame_by_frame(self._gyro)

    @property
    def uses_rates(self) -> bool:
        """Whether the method predicts the attitude with the rates of a gyro."""
        return self.identifier.uses_rates

    @property
    def has_rates(self) -> bool:
        """Whether rates of a gyro came."""
        return self._frames.has_rates

    @property
    def prediction(self) -> str:
        """Return what the last frame was identified with, in words; empty without prediction."""
        return self._frames.condition

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Use the rate (3,) about sensor axes measured up to a time; False if unusable."""
        return self._frames.add_rate(stamp_ns, rate_rad_s)

    def is_idle(self, stamp_ns: int, tracking: bool, windowed: bool = False) -> bool:
        """
        Return whether a frame needs no identification, as the star tracker follows the stars.

        A windowed frame, of stars that the tracker predicted, is not a check of its tracks.
        """
        if self.uses_rates or not tracking:
            return False
        if not self._check_period_ns or windowed:
            return True
        return (self._identified_ns is not None
                and abs(stamp_ns - self._identified_ns) < self._check_period_ns)

    def identify(self, stamp_ns: int, centroids: Centroids) -> tuple[Identification, Centroids]:
        """
        Identify the frame of a time; return the centroids at that time as well.

        The stars of a rolling shutter are moved to the time of the frame by the rate between it
        and the frame before. Without one they are first identified with a wide tolerance, and the
        rate is that which explains their residuals.
        """
        self._identified_ns = stamp_ns
        found: Identification | None = None
        if centroids.delay_s.any():
            seen, centroids = centroids, self._moved_by_frame_before(stamp_ns, centroids)
            if centroids is not seen:
                found = self._frames.identify(stamp_ns, centroids)
            if found is None or found.attitude is None:
                found, centroids = None, self._at_frame_time(seen)
        found = found or self._frames.identify(stamp_ns, centroids)
        return self._without_bodies(stamp_ns, found, centroids), centroids

    def _without_bodies(self, stamp_ns: int, found: Identification, centroids: Centroids
                        ) -> Identification:
        """Return an identification in which planets, Moon and Sun are not stars."""
        self.body_spots = 0
        bodies, camera = bodies_at(stamp_ns), self.identifier.camera
        if found.attitude is None or bodies is None or not bodies.reach(
                matrix_from_quaternion(found.attitude.quaternion)[:, 2],
                _FIELD_MARGIN * camera.corner_angle_rad / min(found.focal_ratio, 1.0)):
            return found
        mapping = SkyMapping(camera.with_focal_ratio(found.focal_ratio), found.attitude.quaternion)
        spots = Bodies(bodies).spots(mapping, centroids, found.magnitude)
        self.body_spots = int(np.count_nonzero(spots))
        if not (spots & (found.hip > 0)).any():
            return found
        return replace(found, hip=np.where(spots, 0, found.hip).astype(np.int32),
                       magnitude=np.where(spots, np.nan, found.magnitude),
                       residual_px=np.where(spots, np.nan, found.residual_px))

    def _moved_by_frame_before(self, stamp_ns: int, centroids: Centroids) -> Centroids:
        """Return the centroids at the time of the frame, the same where no rate is found."""
        camera = self.identifier.camera
        before, self._before = self._before, (stamp_ns, centroids)
        if before is None:
            return centroids
        rate_rad_s = rate_between_frames(
            camera, before[1], centroids, (stamp_ns - before[0]) * 1e-9)
        return centroids if rate_rad_s is None else at_frame_time(camera, centroids, rate_rad_s)

    def _at_frame_time(self, centroids: Centroids) -> Centroids:
        """Return the centroids at the time of the frame, where their rate can be found."""
        camera, onboard = self.identifier.camera, self.identifier.onboard
        for floor_px in SHEAR_PX:
            blurred = replace(centroids, sigma_px=np.hypot(centroids.sigma_px, floor_px))
            found = self.identifier.identify(blurred)
            if found.attitude is None:
                continue
            star_index = onboard.index_of(found.hip)
            known = star_index >= 0
            rate_rad_s = fit_rate(camera, onboard.direction[star_index[known]],
                                  centroids.select(known), found.attitude.quaternion)
            if rate_rad_s is not None:
                return at_frame_time(camera, centroids, rate_rad_s)
        return centroids
