# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Independent tracks: the JPDA filter of Sadeghi, Sabahi and Saberali, and their baseline."""

from dataclasses import replace
import math

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeError, AttitudeEstimate
from startracker_ros.core.attitude.gyro import Gyro
from startracker_ros.core.attitude.result import with_correlated_error
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.papers.jpdaf import associate_stars, predict, update
from startracker_ros.core.papers.neighbourhood import propagated, star_neighbourhood
from startracker_ros.core.track.attitude_model import GYRO_SILENCE_S
from startracker_ros.core.track.model import FrameUpdate, rate_between, StarModel
from startracker_ros.core.track.motion_models import (
    body_rate, constant_velocity, coordinated_turn, image_jacobian, POSITION, turn_curvature,
    VELOCITY)
from startracker_ros.core.track.options import TrackerOptions
from startracker_ros.core.track.rolling_shutter import at_frame_time
from startracker_ros.core.track.rotation_fit import fit_rotation, OUTLIER_SIGMA, RotationFit
from startracker_ros.core.track.start import Start


class IndependentStarsModel(StarModel):
    """A filter of position and velocity on the image for each star (JPDAF)."""

    def __init__(self, camera: Camera, options: TrackerOptions, gyro: Gyro) -> None:
        super().__init__(camera, options)
        self._gyro = gyro
        self._centre = np.array([camera.cx, 0.0, camera.cy, 0.0])

    def start(self, start: Start) -> None:
        self._stamp_ns = start.frame.stamp_ns
        self.rate_rad_s, self.rate_covariance = start.rate, start.rate_covariance
        self._roll_rad_s = self._measured_roll(self._stamp_ns - 1, self._stamp_ns)
        self._roll_acceleration_rad_s2 = np.radians(self._options.roll_acceleration_deg_s2)
        acceleration_rad_s2 = np.radians(self._options.acceleration_deg_s2)
        self._acceleration_px_s2 = (acceleration_rad_s2 * self._camera.fx,
                                    acceleration_rad_s2 * self._camera.fy)

    def update(self, stamp_ns: int, frame: Centroids, sky: ApparentCatalog) -> FrameUpdate:
        frame = at_frame_time(self._camera, frame, self.rate_rad_s)
        self._predict(stamp_ns)
        self._stamp_ns = stamp_ns
        unassociated = self._update(frame, sky)
        fit = self._fit(sky)
        if fit is None or not fit.is_good(
                int(np.count_nonzero(self.bank.confirmed)), self._options.min_stars,
                self._options.max_residual_px):
            if self.uses_gyro and not self.is_sparse(frame):
                self.gyro_trouble = ('the stars are not where the roll of imu has them: is it in '
                                     'rad/s and on the axes of the sensor?')
            return FrameUpdate(False, fit, frame, unassociated)
        self._estimate_rate(fit)
        fit = replace(fit, attitude=with_correlated_error(
            fit.attitude, frame.correlated_error, self._camera))
        return FrameUpdate(True, fit, frame, unassociated)

    def _predict(self, stamp_ns: int) -> None:
        bank, is_turn = self.bank, self._options.model == 'coordinated_turn'
        dt_s = (stamp_ns - self._stamp_ns) * 1e-9
        roll_before, roll = self._rolls(stamp_ns)
        rate_rad_s = self.rate_rad_s - [0.0, 0.0, roll_before]
        if is_turn:
            # The image turns against the body. Density for the same change of velocity per step.
            u, v = self._acceleration_px_s2
            transition, noise = coordinated_turn(
                dt_s, -rate_rad_s[2], (u * math.sqrt(dt_s), v * math.sqrt(dt_s)))
        else:
            transition, noise = constant_velocity(dt_s, self._acceleration_px_s2)
        if self.uses_gyro:
            transition = (rolled(self._camera, roll, dt_s) @ transition
                          @ rolled(self._camera, -roll_before, 0.0))
        noise = self._noise_factors()[:, None, None] * (noise + self._roll_noise(dt_s))
        state, covariance = predict(bank.state - self._centre, bank.covariance, transition, noise)
        state += self._centre
        if not is_turn:
            state += turn_curvature(self._camera, bank.uv, rate_rad_s, dt_s)
        self.rate_rad_s = rate_rad_s + [0.0, 0.0, roll]
        bank = replace(bank, state=state, covariance=covariance)
        self.bank = bank.select(self._camera.contains(bank.uv))

    def _rolls(self, stamp_ns: int) -> tuple[float, float]:
        """
        Return the measured roll rates, rad/s, that the velocities contain and will contain.

        Zero where none is measured: then the roll is part of the motion that the model predicts.
        """
        before, self._roll_rad_s = self._roll_rad_s, self._measured_roll(self._stamp_ns, stamp_ns)
        self.uses_gyro = self._roll_rad_s is not None
        self.gyro_trouble = ('' if self.uses_gyro or not self._options.roll_by_gyro else
                             'no rates of imu: roll_by_gyro has no effect')
        if self._roll_rad_s is None:
            return 0.0, 0.0
        return self._roll_rad_s if before is None else before, self._roll_rad_s

    def _measured_roll(self, from_ns: int, to_ns: int) -> float | None:
        """Return the mean body rate z between two times by a gyro, None without one."""
        if not self._options.roll_by_gyro or self._gyro.silent_s(to_ns) > GYRO_SILENCE_S:
            return None
        return float(self._gyro.mean_rate(from_ns, to_ns)[0][2])

    def _roll_noise(self, dt_s: float) -> np.ndarray:
        """Return the process noise (N, 4, 4) of a roll of the camera, and that of the gyro."""
        camera, velocity = self._camera, self._roll_acceleration_rad_s2 * dt_s
        position = velocity * dt_s / 2
        roll = np.outer([position, velocity], [position, velocity])
        if self.uses_gyro:
            roll[0, 0] += self._gyro.noise_density * dt_s
        x, y = (self.bank.uv - self._centre[POSITION]).T
        along = np.stack([y * camera.fx / camera.fy, -x * camera.fy / camera.fx], 1)
        return np.einsum('na,nb,ij->naibj', along, along, roll).reshape(-1, 4, 4)

    def _update(self, frame: Centroids, sky: ApparentCatalog) -> np.ndarray:
        """Update the tracks by a frame; return the mask (M,) of its centroids in no gate."""
        bank, sigma_px = self.bank, self.sigma_px(frame)
        variance = sigma_px ** 2
        confirmed = None
        if self._options.sna_confirmation:
            confirmed = star_neighbourhood(
                self._camera, bank.uv, sky.direction(bank.star_index), frame.uv, sigma_px)
        probability, unassociated = associate_stars(
            bank.uv, bank.uv_covariance, frame.uv, variance, self._detection,
            self._options.association, confirmed)
        state, covariance = update(bank.state, bank.covariance, frame.uv, variance, probability)
        self.bank = bank.associated(
            bank.uv, probability, frame, variance, state, covariance)
        return unassociated

    def _noise_factors(self) -> np.ndarray:
        """
        Return the factors (N,) by which the process noise of each track is multiplied.

        An acceleration of the camera moves all stars alike and does not average out over
        them as centroid errors do: with a factor of 1 the covariance of the attitude of all
        tracks would be too small. The factor is the variance of a star over that of the
        mean of all stars, N if they are equally good. Then each track has the gain of one filter
        of the common motion, and the attitude of all tracks the covariance of that filter.
        """
        bank = self.bank
        information = np.sum(1 / bank.variance[bank.confirmed])
        # The attitude by TRIAD is that of two tracks.
        most = 2.0 if self._options.solver == 'triad' else np.inf
        return np.clip(bank.variance * information, 1.0, most)

    def _fit(self, sky: ApparentCatalog) -> RotationFit | None:
        try:
            return fit_rotation(self._camera, sky.direction(self.bank.star_index),
                                self.bank.uv, self.bank.sigma_uv, self.bank.detected,
                                self._options.solver)
        except AttitudeError:
            return None

    def _estimate_rate(self, fit: RotationFit) -> None:
        bank = self.bank.select(self.bank.detected & (fit.normalised <= OUTLIER_SIGMA))
        self.rate_rad_s, self.rate_covariance = body_rate(
            image_jacobian(self._camera, self._camera.unproject(bank.uv)),
            bank.state[:, 1::2], bank.covariance[:, 1::2, 1::2])


class NeighbourhoodModel(IndependentStarsModel):
    """No filter (SNA): measured positions, propagated by the body rate of two frames."""

    def start(self, start: Start) -> None:
        super().start(start)
        self._fitted = start.frame.stamp_ns, start.frame.attitude

    def _predict(self, stamp_ns: int) -> None:
        bank, dt_s = self.bank, (stamp_ns - self._stamp_ns) * 1e-9
        state, covariance = bank.state.copy(), bank.covariance.copy()
        state[:, POSITION] = propagated(self._camera, bank.uv, self.rate_rad_s, dt_s)
        covariance[:, ::2, ::2] += dt_s ** 2 * covariance[:, 1::2, 1::2]
        bank = replace(bank, state=state, covariance=covariance)
        self.bank = bank.select(self._camera.contains(bank.uv))

    def _update(self, frame: Centroids, sky: ApparentCatalog) -> np.ndarray:
        bank, sigma_px = self.bank, self.sigma_px(frame)
        centroid = star_neighbourhood(
            self._camera, bank.uv, sky.direction(bank.star_index), frame.uv, sigma_px)
        detected = np.flatnonzero(centroid >= 0)
        state, covariance = bank.state.copy(), bank.covariance.copy()
        state[detected[:, None], POSITION] = frame.uv[centroid[detected]]
        covariance[detected, ::2, ::2] = (
            sigma_px[centroid[detected]] ** 2)[:, None, None] * np.eye(2)
        probability = np.zeros((len(bank), len(frame) + 1))
        probability[np.arange(len(bank)), centroid + 1] = 1
        self.bank = bank.associated(
            bank.uv, probability, frame, sigma_px ** 2, state, covariance)
        return ~np.isin(np.arange(len(frame)), centroid)

    def _set_rate(self, before_ns: int, before: AttitudeEstimate, after_ns: int,
                  after: AttitudeEstimate) -> None:
        dt_s = (after_ns - before_ns) * 1e-9
        self.rate_rad_s = rate_between(before_ns, before, after_ns, after)
        self.rate_covariance = (before.covariance_sensor + after.covariance_sensor) / dt_s ** 2

    def _estimate_rate(self, fit: RotationFit) -> None:
        before_ns, before = self._fitted
        self._fitted = self._stamp_ns, fit.attitude
        self._set_rate(before_ns, before, self._stamp_ns, fit.attitude)
        jacobian = image_jacobian(self._camera, self._camera.unproject(self.bank.uv))
        self.bank.state[:, VELOCITY] = jacobian @ self.rate_rad_s
        self.bank.covariance[:, 1::2, 1::2] = (
            jacobian @ self.rate_covariance @ np.swapaxes(jacobian, 1, 2))


def rolled(camera: Camera, rate_rad_s: float, dt_s: float) -> np.ndarray:
    """
    Return the transition (4, 4) of a star, as seen from the principal point, by a known roll.

    Position and velocity turn by rate_rad_s dt_s (body rate z), and the velocity gains that of the
    image under rate_rad_s. With F of the motion without the roll the state becomes
    rolled(rate, dt) F rolled(-rate before, 0) X: equation 18 of Sadeghi, Sabahi and Saberali.
    """
    aspect = camera.fx / camera.fy
    sine, cosine = math.sin(rate_rad_s * dt_s), math.cos(rate_rad_s * dt_s)
    turn = np.array([[cosine, sine * aspect], [-sine / aspect, cosine]])
    flow = rate_rad_s * np.array([[0.0, aspect], [-1 / aspect, 0.0]])
    return np.kron(turn, np.eye(2)) + np.kron(flow @ turn, [[0.0, 0.0], [1.0, 0.0]])
