# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
A Kalman filter of the lens over tracked stars: focal length, principal point, k1, temperature.

The attitude of each frame is eliminated, as in adjustment.py, so no error of it reaches the
lens. The state is the change against the initial camera, each parameter in px by which it moves a
star in the corner of the image: [focal length at the reference temperature, cx, cy, k1, focal
length per kelvin], (5,). The first four are random walks.
"""

from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.calibration.adjustment import (
    CalibrationError, changed_camera, lens_partials, parameter_values, projected_out,
    rotation_partials)
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import conjugate, rotate

NAMES = ('focal', 'cx', 'cy', 'k1')
"""Parameters of the lens, those of adjustment.py."""

LENS = len(NAMES)
LEAST_STARS = 8
"""Of a frame: 16 numbers for its attitude, the lens and the scatter of the stars."""

# Of silicon optics and metal barrels the focal length changes by 1e-6 .. 3e-5 per kelvin.
_FOCAL_PER_KELVIN = 3e-5
_HOUR_S = 3600.0
_REJECTION_SIGMAS = 4.0
_MOST_REJECTED = 0.25  # of the stars of a frame
_LARGEST_SCATTER = 5.0  # of the stars, in units of their sigma
# Exponential mean of the scatter of the stars over frames.
_MEMORY = 0.1
_GATE = gate(1e-6, LENS)


@dataclass(frozen=True)
class LensFrame:
    """
    Identified stars of one frame.

    uv (N, 2) px are the centroids, sigma_px (N,) their errors per axis, icrf (N, 3) the apparent
    directions; quaternion (4,) q_icrf_from_sensor by the same stars; temperature_c of the lens,
    NaN where it is unknown.
    """

    stamp_ns: int
    uv: np.ndarray
    sigma_px: np.ndarray
    icrf: np.ndarray
    quaternion: np.ndarray
    temperature_c: float = math.nan


class Normalised(NamedTuple):
    """Residuals (2N,) of a frame, derivatives (2N, 4), (2N, 3) by lens and attitude, / sigma."""

    residual: np.ndarray
    lens: np.ndarray
    rotation: np.ndarray


class LensFilter:
    """
    The estimated lens of one camera; initial is the camera at the start.

    sigma_px is what is known of each parameter then, walk_px_sqrt_h its random walk, both as
    shift of a star in the corner. mean (5,) and covariance (5, 5) are of the state; variance is
    that of the stars in units of sigma^2.
    """

    def __init__(self, initial: Camera, sigma_px: float, walk_px_sqrt_h: float) -> None:
        self.initial = initial
        radius = initial.radius(initial.corner_angle_rad)
        self._unit = np.array([1 / radius, 1.0, 1.0, 1 / (initial.fx * radius ** 3)])
        self._walk = np.array([walk_px_sqrt_h ** 2 / _HOUR_S] * LENS + [0.0])
        self.mean = np.zeros(LENS + 1)
        slope_px = _FOCAL_PER_KELVIN * initial.fx * radius
        self.covariance = np.diag(np.square([*[sigma_px] * LENS, slope_px]))
        self.variance = 1.0
        self._frames = 0
        self._reference_c = math.nan
        self._stamp_ns: int | None = None

    # --- the estimate ---

    def at(self, temperature_c: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the lens (4,) in px in the corner at a temperature, and its covariance (4, 4)."""
        H = self._design(temperature_c)
        return H @ self.mean, H @ self.covariance @ H.T

    def _design(self, temperature_c: float) -> np.ndarray:
        H = np.eye(LENS, LENS + 1)
        kelvin = temperature_c - self._reference_c
        H[0, LENS] = kelvin if math.isfinite(kelvin) else 0.0
        return H

    def camera(self, lens: np.ndarray) -> Camera:
        """Return the camera of a lens (4,); CameraError for an impossible one."""
        return changed_camera(self.initial, dict(zip(NAMES, lens * self._unit)))

    def lens_of(self, camera: Camera) -> np.ndarray:
        """Return the lens (4,) of a camera of the same model."""
        before, after = parameter_values(self.initial), parameter_values(camera)
        return np.array([after[name] - before[name] for name in NAMES]) / self._unit

    def figures(self, temperature_c: float) -> dict[str, tuple[float, float]]:
        """Return each parameter and its 1-sigma error; focal_ppm_k with a temperature."""
        lens, covariance = self.at(temperature_c)
        value = parameter_values(self.camera(lens))
        sigma = np.sqrt(np.diag(covariance)) * self._unit
        found = {name: (float(value[name]), float(sigma[k])) for k, name in enumerate(NAMES)}
        if math.isfinite(self._reference_c):
            ppm = 1e6 * self._unit[0] / self.initial.fx
            found['focal_ppm_k'] = (float(self.mean[LENS] * ppm),
                                    float(math.sqrt(self.covariance[LENS, LENS]) * ppm))
        return found

    # --- frames ---

    def checked(self, frame: LensFrame) -> LensFrame:
        """
        Return a frame without stars that do not fit, at the time and temperature of the filter.

        CalibrationError says why a frame cannot be of this camera.
        """
        check_stars(frame, self.initial)
        if math.isnan(self._reference_c):
            self._reference_c = frame.temperature_c
        self._predict(frame.stamp_ns)
        lens, covariance = self.at(frame.temperature_c)
        stars = self.normalised(self.camera(lens), frame)
        both = np.hstack([stars.rotation, stars.lens])
        square = np.square(projected_out(both, stars.residual)).reshape(-1, 2).sum(axis=1)
        count = len(square)
        # The median of the squares of two axes is 2 ln 2 variances.
        freedom = 1 - both.shape[1] / (2 * count)
        variance = max(1.0, float(np.median(square)) / (2 * math.log(2)) / freedom)
        if variance > _LARGEST_SCATTER ** 2:
            raise CalibrationError(
                f'stars scatter by {math.sqrt(variance):.0f} times their sigma about any lens '
                'near camera_info: wrong stars, or another camera')
        near = square <= _REJECTION_SIGMAS ** 2 * variance
        if np.count_nonzero(~near) > _MOST_REJECTED * count or near.sum() < LEAST_STARS:
            raise CalibrationError(f'{np.count_nonzero(~near)} of {count} stars fit no lens near '
                                   'camera_info: wrong stars, or another camera')
        frame = replace(frame, uv=frame.uv[near], sigma_px=frame.sigma_px[near],
                        icrf=frame.icrf[near])
        self._check_lens(frame, lens, covariance)
        self._frames += 1
        self.variance += max(1 / self._frames, _MEMORY) * (variance - self.variance)
        return frame

    def _check_lens(self, frame: LensFrame, lens: np.ndarray, covariance: np.ndarray) -> None:
        """Raise CalibrationError for a frame with a lens that the covariance does not allow."""
        design, residual = self.reduced(self.camera(lens), frame)
        information = design.T @ design
        gradient = design.T @ residual
        # y = A'r has the covariance Y + Y P Y.
        S = information + information @ covariance @ information
        if gradient @ np.linalg.lstsq(S, gradient, rcond=None)[0] > _GATE:
            off_px = float(np.median(frame.sigma_px)) * math.sqrt(
                self.variance * float(np.mean(residual ** 2)))
            raise CalibrationError(
                f'stars are {off_px:.2g} px off, more than the lens may have changed: another '
                'camera, or a larger lens_sigma_px')

    def update(self, frame: LensFrame) -> None:
        """
        Update the state by a checked frame: P <- (P^-1 + Y)^-1, x <- x + P A'r.

        A is the design without attitude, Y = A'A.
        """
        lens, _ = self.at(frame.temperature_c)
        design, residual = self.reduced(self.camera(lens), frame)
        A = design @ self._design(frame.temperature_c)
        P = np.linalg.inv(np.linalg.inv(self.covariance) + A.T @ A)
        self.covariance = (P + P.T) / 2
        self.mean = self.mean + self.covariance @ (A.T @ residual)

    def _predict(self, stamp_ns: int) -> None:
        dt_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = stamp_ns
        self.covariance = self.covariance + np.diag(self._walk * max(0.0, dt_s))

    def reduced(self, camera: Camera, frame: LensFrame) -> tuple[np.ndarray, np.ndarray]:
        """Return design (2N, 4) and residual (2N,) of a frame, / sigma, without its attitude."""
        stars = self.normalised(camera, frame)
        scale = math.sqrt(self.variance)
        return (projected_out(stars.rotation, stars.lens) / scale,
                projected_out(stars.rotation, stars.residual) / scale)

    def normalised(self, camera: Camera, frame: LensFrame) -> Normalised:
        """Return residuals and derivatives of a frame, divided by sigma_px."""
        direction = rotate(conjugate(frame.quaternion), frame.icrf)
        weight = np.repeat(1 / frame.sigma_px, 2)
        residual = (frame.uv - camera.project(direction)).ravel() * weight
        lens = lens_partials(camera, direction, NAMES).reshape(-1, LENS) * self._unit
        rotation = rotation_partials(camera, direction).reshape(-1, 3)
        return Normalised(residual, lens * weight[:, None], rotation * weight[:, None])


def check_stars(frame: LensFrame, camera: Camera) -> None:
    """Raise CalibrationError for stars that do not measure a camera; the text says why."""
    if len(frame.uv) < LEAST_STARS:
        raise CalibrationError(
            f'{len(frame.uv)} identified stars in a frame, {LEAST_STARS} are needed')
    if not (np.isfinite(frame.uv).all() and np.isfinite(frame.icrf).all()
            and np.isfinite(frame.quaternion).all()):
        raise CalibrationError('NaN or infinity among the pixels or directions of stars')
    if not (frame.sigma_px > 0).all() or not np.isfinite(frame.sigma_px).all():
        raise CalibrationError('sigma_px of a star is not positive and finite')
    inside = camera.contains(frame.uv)
    if not inside.all():
        u, v = frame.uv[~inside][0]
        raise CalibrationError(
            f'star at u = {u:.1f}, v = {v:.1f} px is outside of the {camera.width} x '
            f'{camera.height} px of camera_info: another camera')
