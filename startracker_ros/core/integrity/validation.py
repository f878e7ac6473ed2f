# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude of one frame of known stars, reported only when it can be trusted."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from startracker_ros.core.attitude.result import AttitudeEstimate, SOLVERS
from startracker_ros.core.camera.lens import Lens, project, rays, undistorted
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.compiled import compiled
from startracker_ros.core.integrity.checks import (
    COVARIANCE, FEW_STARS, LARGE_CHI2, STAR_OUTLIER, STAR_RESIDUALS, TRACK_RESIDUALS)
from startracker_ros.core.integrity.protection import (
    is_covariance, protection_level, ProtectionOptions)
from startracker_ros.core.maths.compiled_rotation import matrix_from_quaternion, sensor_directions
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import sign_continuous
from startracker_ros.core.options import option, Options

_OUTLIER_SIGMA = STAR_OUTLIER.sigmas

UNUSED_SOLVER = (
    'attitude_estimator.solver = {} has no effect on the attitude of a star tracker: set '
    'star_tracker.solver, with another model than attitude')


@dataclass(frozen=True)
class ValidationOptions(Options):
    """The solver, and the limits that an attitude must keep to be published."""

    solver: str = option(
        'quest', 'solver of stars of single frames and of tracks without tracked_attitude, which '
        'star_tracker solves by its own: quest, davenport and svd find the same best fit of all '
        'stars, triad takes the two that determine the attitude best',
        choices=SOLVERS, live=True)
    min_stars: int = option(
        4, 'fewest stars of a trusted attitude; three or fewer leave no room to notice a wrong '
        'one',
        low=2, high=100, live=True)
    max_residual_px: float = option(
        1.0, 'largest rms residual of the stars, measured minus catalogue; '
        'raise it for a lens that is not calibrated', unit='px', low=0.01, high=100.0,
        live=True)


@dataclass(frozen=True)
class TrustedAttitude:
    """An attitude, or None and the reason why there is none."""

    attitude: AttitudeEstimate | None
    reason: str
    _protection: Callable[[], np.ndarray] | None = field(default=None, repr=False, compare=False)

    @cached_property
    def protection_rad(self) -> np.ndarray:
        """
        Bound (3,) of the errors about sensor axes, computed when it is asked for.

        As in protection.py; infinite where there is no bound, or no attitude.
        """
        return np.full(3, np.inf) if self._protection is None else self._protection()


class AttitudeValidator:
    """
    Accepts or rejects attitudes, solved here or by a star tracker.

    The sign of the quaternion is continuous from one accepted attitude to the next.
    """

    def __init__(self, camera: Camera, options: ValidationOptions,
                 protection: ProtectionOptions = ProtectionOptions()) -> None:
        self._camera = camera
        self._options, self._protection = options, protection
        self.reset()

    def set_limits(self, options: ValidationOptions, protection: ProtectionOptions) -> None:
        """Use other options from the next frame on."""
        self._options, self._protection = options, protection

    def reset(self) -> None:
        """Forget the sign of the last quaternion."""
        self._previous: np.ndarray | None = None

    def solve(self, sky: ApparentCatalog, uv: np.ndarray, hip: np.ndarray,
              error_px2: np.ndarray) -> TrustedAttitude:
        """
        Return the attitude of stars at pixels uv (N, 2) with covariances error_px2 (N, 2, 2).

        Stars that the catalogue does not hold (hip 0) are left out. Where errors are not round,
        the best fit to them starts at that of the solver, unless this takes two stars only. The
        covariance is inflated when chi2 rejects the residuals at such errors, and contains what is
        not known of the observer: its velocity, the epoch of the stars.
        """
        # What only solve() needs takes long to import.
        from startracker_ros.core.attitude.error_ellipses import fit_error_ellipses
        from startracker_ros.core.attitude.estimate import (
            AttitudeError, estimate_attitude, mean_chi2)
        from startracker_ros.core.integrity.systematic_errors import with_observer_error
        known, icrf = _known(sky, hip)
        if len(icrf) < self._options.min_stars:
            return self._too_few(len(icrf), 'identified')
        uv, error_px2 = uv[known], error_px2[known]
        sigma_rad = self._camera.pixel_rad * np.sqrt(
            np.trace(error_px2, axis1=1, axis2=2) / 2)
        try:
            sensor = self._camera.unproject(uv)
            attitude = estimate_attitude(sensor, icrf, sigma_rad, self._options.solver)
        except AttitudeError as error:
            return TrustedAttitude(None, str(error))
        mean = mean_chi2(attitude, icrf, sigma_rad)
        if self._options.solver != 'triad':
            attitude = fit_error_ellipses(attitude, self._camera, uv, icrf, error_px2)
        residual_px = np.sqrt(np.mean(attitude.residual_rad ** 2)) / self._camera.pixel_rad
        if residual_px > self._options.max_residual_px:
            return TrustedAttitude(None, STAR_RESIDUALS.diagnostic.format(
                residual_px=residual_px, limit=self._options.max_residual_px))
        is_large = attitude.chi2 > gate(LARGE_CHI2.probability, mean)
        excess = attitude.chi2 / mean if is_large else 1.0
        attitude = with_observer_error(
            replace(attitude, covariance_sensor=attitude.covariance_sensor * excess),
            sky.observer, sensor, sigma_rad, sky.motion(sky.onboard.index_of(hip[known])))
        return self._trusted(attitude, partial(
            protection_level, attitude.covariance_sensor, sensor, sigma_rad,
            attitude.residual_rad, self._protection))

    def check(self, sky: ApparentCatalog, tracked: AttitudeEstimate, uv: np.ndarray,
              hip: np.ndarray, sigma_px: np.ndarray, residual_px: np.ndarray) -> TrustedAttitude:
        """
        Return the attitude of a star tracker, if the rms residual of its tracks (N,) is small.

        uv (N, 2) px are the positions of the tracks, sigma_px and residual_px (N,) those of their
        centroids.
        """
        known, icrf = _known(sky, hip)
        if len(icrf) < self._options.min_stars:
            return self._too_few(len(icrf), 'tracked')
        if len(icrf) < len(uv):
            uv, sigma_px, residual_px = uv[known], sigma_px[known], residual_px[known]
        distance_px, rms_px = star_distances(
            self._camera.lens, tracked.quaternion, icrf, np.ascontiguousarray(uv))
        if not rms_px <= self._options.max_residual_px:
            return TrustedAttitude(None, TRACK_RESIDUALS.diagnostic.format(
                residual_px=rms_px, limit=self._options.max_residual_px))
        return self._trusted(AttitudeEstimate(
            tracked.quaternion, tracked.covariance_sensor, len(icrf),
            distance_px * self._camera.pixel_rad, tracked.chi2, tracked.budget), partial(
                self._protection_of_tracks, tracked.covariance_sensor, uv, sigma_px, residual_px,
                self._protection))

    def _protection_of_tracks(
            self, covariance: np.ndarray, uv: np.ndarray, sigma_px: np.ndarray,
            residual_px: np.ndarray, options: ProtectionOptions) -> np.ndarray:
        return protection_level(covariance, *_tracked_stars(
            self._camera.lens, self._camera.pixel_rad,
            *map(np.ascontiguousarray, (uv, sigma_px, residual_px))), options)

    def _trusted(self, attitude: AttitudeEstimate, protection: Callable[[], np.ndarray]
                 ) -> TrustedAttitude:
        """Return an attitude with its protection level, unless its covariance is none."""
        covariance = attitude.covariance_sensor
        if not is_covariance(covariance):
            return TrustedAttitude(None, COVARIANCE.diagnostic.format(
                variances=np.diag(covariance).tolist()))
        self._previous = sign_continuous(attitude.quaternion, self._previous)
        if self._previous is not attitude.quaternion:
            attitude = replace(attitude, quaternion=self._previous)
        return TrustedAttitude(attitude, 'trusted', protection)

    def _too_few(self, count: int, kind: str) -> TrustedAttitude:
        return TrustedAttitude(None, FEW_STARS.diagnostic.format(
            count=count, kind=kind, limit=self._options.min_stars))


def _known(sky: ApparentCatalog, hip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which stars (N,) the catalogue holds, and the directions (K, 3) of these."""
    index = sky.onboard.index_of(hip)
    known = index >= 0
    return known, sky.direction(index if known.all() else index[known])


@compiled
def star_distances(lens: Lens, quaternion: np.ndarray, icrf: np.ndarray, uv: np.ndarray
                   ) -> tuple[np.ndarray, float]:
    """
    Return the distances (N,) px of pixels uv (N, 2) from stars icrf (N, 3), and their rms.

    By an attitude (4,), q_icrf_from_sensor; NaN for a star behind the camera.
    """
    predicted = project(lens, sensor_directions(matrix_from_quaternion(quaternion), icrf))
    distance, square = np.empty(len(uv)), 0.0
    for n in range(len(uv)):
        distance[n] = np.hypot(uv[n, 0] - predicted[n, 0], uv[n, 1] - predicted[n, 1])
        square += distance[n] ** 2
    return distance, np.sqrt(square / len(uv))


@compiled
def _tracked_stars(lens: Lens, pixel_rad: float, uv: np.ndarray, sigma_px: np.ndarray,
                   residual_px: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors (N, 3) of tracks, and errors and residuals (N,) rad of centroids."""
    away_rad = np.empty(len(uv))
    for n in range(len(uv)):
        # A centroid further away is none of the star, and was not used.
        away_px = min(residual_px[n], _OUTLIER_SIGMA * sigma_px[n])
        away_rad[n] = 0.0 if np.isnan(residual_px[n]) else away_px * pixel_rad
    return rays(lens.equidistant, undistorted(lens, uv)), sigma_px * pixel_rad, away_rad
