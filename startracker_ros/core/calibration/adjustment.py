# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Bundle adjustment: the camera and the attitudes that best fit the stars of many frames.

The attitude of each frame is eliminated: its part of the normal equations is projected out,
frame by frame, and only the few parameters of the lens remain (Triggs et al., Bundle
Adjustment - A Modern Synthesis, 2000, section 6; the projection of Golub and Pereyra 1973).

One focal length is estimated. The pixel pitch of a sensor is more uniform than stars can
measure, and on the ground refraction would appear as a difference of fx and fy. The ratio
fy / fx stays that of the initial camera.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import brentq
from startracker_ros.core.camera.distortion import plane_points, terms_of
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)

TERMS = {'focal': ('focal',), 'k1': ('k1',), 'centre': ('cx', 'cy'), 'tangential': ('p1', 'p2'),
         'k2': ('k2',), 'k3': ('k3',), 'k4': ('k4',)}
"""Terms that can be estimated, in the order of trial, and the parameters of each: focal length
and principal point in px, coefficients of the distortion model that has them."""

# Stars with larger residuals are rejected as wrong: one correct star in 3000.
_REJECTION_SIGMAS = 4.0
_MAX_STEPS = 50
# From this step on weights are fixed and rejected stars stay rejected, to ensure convergence.
_SETTLING_STEPS = 10
# Converged when every parameter changes by less than this fraction of its error.
_TOLERANCE_SIGMAS = 0.01
# Step of the numerical derivatives by attitude.
_ROTATION_STEP_RAD = 1e-5
# Added to the diagonal of the scaled information: a parameter without information gets a very
# large error.
_NO_INFORMATION = 1e-12


class CalibrationError(ValueError):
    """Stars that do not determine a calibration; the text is the reason."""


@dataclass(frozen=True)
class MatchedStars:
    """
    Centroids of all frames with their catalogue stars.

    uv (N, 2) px; sigma_px (N,) 1-sigma error per axis; icrf (N, 3) unit vectors of the stars;
    frame (N,) index of the frame; flux (N,) DN; hip (N,) and V (N,) of the catalogue.
    """

    uv: np.ndarray
    sigma_px: np.ndarray
    icrf: np.ndarray
    frame: np.ndarray
    flux: np.ndarray
    hip: np.ndarray
    magnitude: np.ndarray

    def __len__(self) -> int:
        return len(self.uv)

    def select(self, chosen: np.ndarray) -> 'MatchedStars':
        """Return the stars of a mask (N,) or of indices."""
        return MatchedStars(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True)
class Adjustment:
    """
    The adjusted camera and attitudes, with covariance and residuals.

    quaternions (F, 4) are q_icrf_from_sensor; terms are those estimated and covariance (P, P)
    that of their parameters, in the order of `parameters`; used (N,) is False for rejected
    stars; residual_px (N, 2) is image minus model; extra_px is the error per axis that the
    residuals show beyond sigma_px, included in the covariance.
    """

    camera: Camera
    quaternions: np.ndarray
    terms: tuple[str, ...]
    covariance: np.ndarray
    used: np.ndarray
    residual_px: np.ndarray
    extra_px: float

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the estimated parameters."""
        return _parameters_of(self.terms)

    @property
    def values(self) -> dict[str, float]:
        """Return the estimated parameters."""
        return {name: parameter_values(self.camera)[name] for name in self.parameters}

    @property
    def sigmas(self) -> dict[str, float]:
        """Return the 1-sigma errors of the estimated parameters."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.covariance)).tolist()))


def adjust(camera: Camera, stars: MatchedStars, quaternions: np.ndarray, terms: tuple[str, ...], *,
           reject: bool = True) -> Adjustment:
    """
    Return the camera and the attitudes (F, 4) that best fit the stars.

    Gauss-Newton from an initial camera and attitudes; only the named terms are estimated.
    Weights are from sigma_px and an additional error, common to all stars, that brings the
    residuals to their expected size. With reject, stars with large residuals are excluded.
    CalibrationError when the iteration does not converge.
    """
    names = _parameters_of(terms)
    frames = len(quaternions)
    freedom = 2 * len(stars) - len(names) - 3 * frames
    if freedom <= 0:
        raise CalibrationError(f'{len(stars)} stars in {frames} images: too few for '
                               f'{len(names)} parameters of the camera and each attitude')
    used = np.ones(len(stars), bool)
    settled = False
    for step in range(_MAX_STEPS):
        direction = _sensor_directions(stars, quaternions)
        residual = stars.uv - camera.project(direction)
        if not np.isfinite(residual).all():
            raise CalibrationError('no camera fits: a star is behind it')
        square = np.einsum('ij,ij->i', residual, residual)
        if step < _SETTLING_STEPS:
            extra = _extra_error(square[used], stars.sigma_px[used], freedom / (2 * len(stars)))
        variance = stars.sigma_px ** 2 + extra ** 2
        near = square <= _REJECTION_SIGMAS ** 2 * variance
        if reject:
            used = near if step < _SETTLING_STEPS else used & near
        weight = used / np.sqrt(variance)
        lens, rotation, covariance = _step(
            residual * weight[:, None], lens_partials(camera, direction, names) * weight[
                :, None, None], rotation_partials(camera, direction) * weight[:, None, None],
            stars.frame, frames)
        if settled:
            return Adjustment(camera, quaternions, terms, covariance, used, residual, extra)
        try:
            camera = changed_camera(camera, dict(zip(names, lens)))
        except CameraError as error:
            raise CalibrationError(f'no camera fits: {error}') from error
        quaternions = multiply(quaternions, quaternion_from_rotation_vector(rotation))
        # The rotations follow from the lens.
        settled = bool(np.all(np.abs(lens) <= _TOLERANCE_SIGMAS * np.sqrt(np.diag(covariance)))
                       and np.abs(rotation).max() < _TOLERANCE_SIGMAS * camera.pixel_rad)
    raise CalibrationError(f'no camera fits: no convergence in {_MAX_STEPS} steps')


def _parameters_of(terms: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for term in terms for name in TERMS[term])


def parameter_values(camera: Camera) -> dict[str, float]:
    """Return all parameters of TERMS that a camera has, by name."""
    return {'focal': camera.fx, 'cx': camera.cx, 'cy': camera.cy,
            **dict(zip(camera.model.coefficients, camera.distortion))}


def changed_camera(camera: Camera, change: dict[str, float]) -> Camera:
    """Return the camera with its parameters changed; CameraError if it is impossible."""
    value = parameter_values(camera)
    for name, by in change.items():
        value[name] += float(by)
    return replace(camera, fx=value['focal'], fy=value['focal'] * camera.fy / camera.fx,
                   cx=value['cx'], cy=value['cy'],
                   distortion=tuple(value[name] for name in camera.model.coefficients))


def _sensor_directions(stars: MatchedStars, quaternions: np.ndarray) -> np.ndarray:
    matrix = matrix_from_quaternion(quaternions)[stars.frame]
    return np.einsum('nij,ni->nj', matrix, stars.icrf)


def lens_partials(camera: Camera, direction: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return the derivatives (N, 2, P) of the pixels of directions (N, 3) by the parameters."""
    plane = plane_points(camera.model.equidistant, direction)
    a, b = plane.T
    s = a * a + b * b
    denominator = 1 + sum(value * s ** (power + 1) for power, value in enumerate(
        terms_of(camera.distortion_model, camera.distortion)[-3:]))
    ones, zeros = np.ones_like(a), np.zeros_like(a)
    focal = np.array([camera.fx, camera.fy])
    partial = {
        'focal': (camera.project(direction) - [camera.cx, camera.cy]) / camera.fx,
        'cx': np.stack([ones, zeros], -1), 'cy': np.stack([zeros, ones], -1),
        'p1': focal * np.stack([2 * a * b, s + 2 * b * b], -1),
        'p2': focal * np.stack([s + 2 * a * a, 2 * a * b], -1),
        **{f'k{power}': focal * plane * (s ** power / denominator)[:, None]
           for power in (1, 2, 3, 4)}}
    return np.stack([partial[name] for name in names], -1) if names else np.empty((len(a), 2, 0))


def rotation_partials(camera: Camera, direction: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 2, 3) of pixels by sensor rotations about x, y, z, px / rad."""
    # A rotation of the sensor by d changes a direction by -d x direction.
    steps = [np.cross(direction, axis) * _ROTATION_STEP_RAD for axis in np.eye(3)]
    return np.stack([(camera.project(direction + step) - camera.project(direction - step))
                     / (2 * _ROTATION_STEP_RAD) for step in steps], -1)


def _step(residual: np.ndarray, lens: np.ndarray, rotation: np.ndarray, frame: np.ndarray,
          frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the change of the lens (P,), of the attitudes (F, 3), and the lens covariance.

    residual (N, 2) r and its derivatives lens (N, 2, P) A and rotation (N, 2, 3) B are divided
    by the errors. Per frame, with Q the orthonormal basis of B: A_p = A - Q Q'A. The change is
    (sum A_p'A_p)^-1 sum A_p'r.
    """
    count = lens.shape[2]
    rows = [np.flatnonzero(frame == i) for i in range(frames)]
    information, gradient = np.zeros((count, count)), np.zeros(count)
    parts = []
    for row in rows:
        a, b = lens[row].reshape(2 * len(row), count), rotation[row].reshape(-1, 3)
        r = residual[row].ravel()
        projected = projected_out(b, a)
        information += projected.T @ projected
        gradient += projected.T @ r
        parts.append((a, b, r))
    # Scaled, since the focal length in px and k3 differ by orders of magnitude.
    scale = np.sqrt(np.diag(information))
    scale[scale == 0] = 1.0
    scale = np.outer(scale, scale)
    covariance = np.linalg.inv(information / scale + _NO_INFORMATION * np.eye(count)) / scale
    change = covariance @ gradient
    rotations = np.array([np.linalg.lstsq(b, r - a @ change, rcond=None)[0]
                              for a, b, r in parts])
    return change, rotations.reshape(frames, 3), covariance


def projected_out(b: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return A - Q Q'A of columns A (K, P), Q an orthonormal basis of the columns B (K, L)."""
    basis = np.linalg.qr(b)[0]
    return a - basis @ (basis.T @ a)


def _extra_error(square: np.ndarray, sigma_px: np.ndarray, freedom: float) -> float:
    """
    Return the error in px, per axis, that residuals show beyond sigma_px (N,).

    square (N,) are the squared residuals of both axes in px^2; freedom is the fraction of the
    squared errors that the fit leaves. The median is robust against wrong stars: for two axes
    it is 2 ln 2 variances of one axis.
    """
    def excess(extra: float) -> float:
        return float(np.median(square / (sigma_px ** 2 + extra ** 2))) / freedom - 2 * np.log(2)
    if excess(0.0) <= 0:
        return 0.0
    return float(brentq(excess, 0.0, np.sqrt(square.max() / freedom)))
