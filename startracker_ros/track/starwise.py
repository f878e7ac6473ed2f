"""A filter for each star: the JPDA filter of Sadeghi, Sabahi and Saberali."""

from dataclasses import replace

import numpy as np

from startracker_ros.attitude.estimate import AttitudeError
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.rotation import attitude_error
from startracker_ros.track.jpdaf import predict, update
from startracker_ros.track.model import Fix, Followed, StarModel
from startracker_ros.track.motion_models import (
    body_rate, constant_velocity, image_jacobian, turn_curvature)
from startracker_ros.track.rotation_fit import fit_rotation, OUTLIER_SIGMA, RotationFit


class StarwiseModel(StarModel):
    """Each star has a position and a velocity of its own on the image."""

    def start(self, fix: Fix, first: Fix) -> None:
        dt_s = (fix.stamp_ns - first.stamp_ns) * 1e-9
        self._stamp_ns = fix.stamp_ns
        self.rate_rad_s = attitude_error(
            fix.attitude.quaternion, first.attitude.quaternion) / dt_s
        self.rate_covariance = (first.attitude.covariance_sensor
                                + fix.attitude.covariance_sensor) / dt_s ** 2
        acceleration_rad_s2 = np.radians(self._options.acceleration_deg_s2)
        self._acceleration_px_s2 = (acceleration_rad_s2 * self._camera.fx,
                                    acceleration_rad_s2 * self._camera.fy)

    def follow(self, stamp_ns: int, frame: Centroids) -> Followed:
        self._predict((stamp_ns - self._stamp_ns) * 1e-9)
        self._stamp_ns = stamp_ns
        bank, variance = self.bank, self._sigma(frame) ** 2
        probability, unclaimed = self._associate(bank.uv, bank.uv_covariance, frame, variance)
        state, covariance = update(bank.state, bank.covariance, frame.uv, variance, probability)
        self.bank = bank.observed(state, covariance, probability, frame, variance)
        fit = self._fit()
        good = fit is not None and fit.is_good(
            np.count_nonzero(self.bank.confirmed), self._options.min_stars,
            self._options.max_residual_px)
        if good:
            self._estimate_rate(fit.normalised <= OUTLIER_SIGMA)
        return Followed(good, fit, unclaimed)

    def _predict(self, dt_s: float) -> None:
        transition, noise = constant_velocity(dt_s, self._acceleration_px_s2)
        noise = self._shares()[:, None, None] * noise
        state, covariance = predict(self.bank.state, self.bank.covariance, transition, noise)
        state += turn_curvature(self._camera, self.bank.uv, self.rate_rad_s, dt_s)
        bank = replace(self.bank, state=state, covariance=covariance)
        self.bank = bank.select(self._camera.contains(bank.uv))

    def _shares(self) -> np.ndarray:
        """Return how many times (N,) the camera's process noise each track is given.

        An acceleration of the camera moves all stars alike, so it does not average out over
        them as centroid errors do: once per track would make the attitude of all tracks
        too sure of itself. Times the variance of a star over that of the mean of all stars,
        which is N times if they are equally good, each track has the gain of one filter
        of the common motion, and the attitude of all tracks the covariance of that filter.
        """
        bank = self.bank
        information = np.sum(1 / bank.variance[bank.confirmed])
        return np.maximum(1.0, bank.variance * information)

    def _fit(self) -> RotationFit | None:
        try:
            return fit_rotation(self._camera, self._places.direction[self.bank.place],
                                self.bank.uv, self.bank.sigma_uv, self.bank.seen)
        except AttitudeError:
            return None

    def _estimate_rate(self, agrees: np.ndarray) -> None:
        bank = self.bank.select(self.bank.seen & agrees)
        self.rate_rad_s, self.rate_covariance = body_rate(
            image_jacobian(self._camera, self._camera.unproject(bank.uv)),
            bank.state[:, 1::2], bank.covariance[:, 1::2, 1::2])
