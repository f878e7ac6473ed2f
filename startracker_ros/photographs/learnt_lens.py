# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The lens of a single image, fitted to its identified stars from where they are known outwards.

The pixel of a star of ICRS direction s is that of v = exp(-[d]x) R^T s in a camera with the focal
length f e^a, the pixel ratio e^b, the principal point c + w (g, h) and the distortion k1 + k. The
parameters d (3,), a, b, g, h, k are found by Gauss-Newton on the squared residuals plus the
squared parameters over their prior variances. The priors hold what the stars do not determine: in
a narrow field k1 has no effect, and the principal point is the same as the attitude. It is the
middle of the image there, unless the stars show it elsewhere with certainty.

Matching and fit alternate: the better the lens, the more stars of the whole image are in the
gate, which follows the scatter of the residuals. A fisheye has the terms k1 to k4, and the gates
of lens_growth.py.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.calibration.matching import nearest_pairs
from startracker_ros.core.camera.distortion import coefficients_of
from startracker_ros.core.camera.lens import Lens, middle_axes
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply)
from startracker_ros.photographs.ladder import Attempt
from startracker_ros.photographs.lens_fit import (
    changed, fit_lens, folds, LEAST_ERROR_PX, linearised, RADIAL, stars_in_image)
from startracker_ros.photographs.lens_growth import gated

# Prior standard deviations: relative pixel ratio, principal point (of the width), k1.
_RATIO, _CENTRE, _K1 = 0.05, 0.04, 0.25
_FISHEYE = [0.06, 0.02, 0.005, 0.001]  # of k1 to k4 of a fisheye
_FREE_ATTITUDE_RAD = 10.0
# So few matches leave lens and attitude open; in a narrow field the lens is then held ideal.
_FEW_MATCHES, _NARROW_RAD = 10, np.radians(20.0)
_HELD = 1e-4  # prior errors of a lens that is held
_LEAST_MATCHES = 4
_MOST_ERROR_PX = 3.0  # 1 sigma of the middle of the image
# Square of the distance from the middle, in sigmas, from which on a principal point is certain.
_CERTAIN_SQUARE = 9.0
_CENTRE_TERMS = slice(5, 7)
_MAX_ITERATIONS = 15
_GATE_SIGMAS = 4.0
# The matching radius at least, and while the first matches lead to those farther out.
_LEAST_GATE_PX, _FIRST_GATE_PX, _GROWING = 1.0, 6.0, 4
# Largest probability that an image star is in the gate of a catalogue star by chance.
_MOST_CHANCE = 0.02
_STEP = 1e-6  # of the numerical derivatives of the middle of the image
_MOST_RESIDUAL = 2.5e-3  # of the width of the image
_LEAST_SHARE = 0.4  # of the stars that image or catalogue have, whichever are fewer
# Below this share the fit may have ended far from the lens: others are tried, with the distortion
# held near each of these values of k1 until their stars stay.
_GOOD_SHARE, _OTHER_K1, _K1_HELD = 0.7, (-0.35, -0.2, -0.1, 0.0, 0.15), 0.02
_KEPT_SHARE = 0.75  # of the matches that lead to the fit
_LIMIT_SIGMAS = 3.0
_SURE_MATCHES, _LIMIT_FACTOR = 12, 2.0


@dataclass(frozen=True)
class LearntLens:
    """
    A fitted camera and its attitude.

    The covariance of attitude contains the errors of the lens; star (N,) is the catalogue index
    of each centroid, -1 for none; residual_px (N,) NaN there. sigma_px is the error per axis that
    the residuals show; rejected says why it is not to be used, empty if it is.
    """

    camera: Camera
    attitude: AttitudeEstimate
    focal_ratio: float
    star: np.ndarray
    residual_px: np.ndarray
    sigma_px: float
    rejected: str

    @property
    def matched(self) -> int:
        """Return the number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class _Lens(NamedTuple):
    """A camera model and an attitude (4,)."""

    model: Lens
    quaternion: np.ndarray

    def camera(self, start: Camera) -> Camera:
        """Return the camera, of the distortion model of start; CameraError for none."""
        model = self.model
        return replace(start, fx=model.fx, fy=model.fy, cx=model.cx, cy=model.cy,
                       distortion=coefficients_of(start.distortion_model, model.terms))


def learn_lens(attempt: Attempt, focal_error: float) -> LearntLens:
    """
    Return the lens and the attitude that fit an identified image.

    The focal length of the nominal camera is known to a share focal_error. The lens is
    rejected when its focal length is beyond that, when it loses the stars that led to it, or when
    no camera has it. ValueError for an attempt without an attitude.
    """
    identification, centroids, nominal = (
        attempt.identification, attempt.centroids, attempt.nominal)
    if identification.attitude is None:
        raise ValueError('an attempt without an attitude')
    onboard, start = attempt.onboard, attempt.camera
    star = onboard.index_of(identification.hip)
    star[identification.hip == 0] = -1
    first = int(np.count_nonzero(star >= 0))
    fisheye = start.model.equidistant
    free = np.array([_FREE_ATTITUDE_RAD] * 3 + [focal_error, _RATIO, _CENTRE, _CENTRE]
                    + (_FISHEYE if fisheye else [_K1]))
    held = np.array([1.0] * 4 + [_HELD] * (len(free) - 4))
    quaternion = identification.attitude.quaternion
    try:
        # A lens at the limit of what a camera can have folds its image at another focal length.
        start = start.with_focal_ratio(identification.focal_ratio)
        lens = _Lens(start.lens, quaternion)
        fit = _grow(lens, start.lens, free, centroids, star, onboard)
        if np.count_nonzero(fit.star >= 0) < _FEW_MATCHES and start.fov_x_rad < _NARROW_RAD:
            fit = _grow(lens, start.lens, free * held, centroids, star, onboard)
        elif not fisheye:
            fit = _best_of_others(fit, lens, start, free, centroids, star, onboard)
            if start.fov_x_rad < _NARROW_RAD:
                fit = _centred(fit, start.lens, free, centroids, onboard)
        camera = fit.lens.camera(start)
    except CameraError as error:
        return LearntLens(start, identification.attitude, 1.0, star,
                          np.full(len(star), np.nan), 0.0, str(error))
    residual = _residuals(fit.lens, centroids, onboard, fit.star)
    attitude = _attitude(fit, residual, centroids)
    return LearntLens(camera, attitude, camera.fx / nominal.fx, fit.star,
                      np.hypot(*residual.T), fit.error_px,
                      _reason(fit, camera, nominal, focal_error, first,
                              _possible(fit, onboard)))


class _Fit(NamedTuple):
    """A lens, the covariance (P, P) of its parameters, error per axis, and stars (N,)."""

    lens: _Lens
    covariance: np.ndarray
    error_px: float
    star: np.ndarray


def _grow(lens: _Lens, start: Lens, free: np.ndarray, centroids: Centroids, star: np.ndarray,
          onboard: OnboardCatalog) -> _Fit:
    """
    Return the lens that is fitted and matched in turn until its stars (N,) stay.

    CameraError when it folds the image.
    """
    for iteration in range(_MAX_ITERATIONS):
        lens, covariance, error_px = _fitted(lens, start, free, centroids, star, onboard)
        model, before, growing = lens.model, star, iteration < _GROWING
        if model.equidistant:
            star = gated(*lens, covariance, max(error_px, _LEAST_GATE_PX / _GATE_SIGMAS),
                         onboard.direction, centroids.uv)
        else:
            gate_px = _gate(error_px, model, onboard,
                            _FIRST_GATE_PX if growing else _LEAST_GATE_PX)
            star = _match(lens, centroids, onboard, gate_px)
        if (np.count_nonzero(star >= 0) < _LEAST_MATCHES
                or not growing and np.array_equal(star, before)):
            break
    return _Fit(lens, covariance, error_px, star)


def _possible(fit: _Fit, onboard: OnboardCatalog) -> int:
    """
    Return how many stars may match: those of the image or of the catalogue in it.

    Where few spots are stars, those are the brightest of the catalogue: it counts as deep as most
    matches are.
    """
    near, _ = stars_in_image(*fit.lens, onboard.direction)
    matched = np.sort(fit.star[fit.star >= 0])
    deepest = matched[int(_KEPT_SHARE * (len(matched) - 1))] if len(matched) else -1
    as_bright = np.count_nonzero(near <= deepest) / _KEPT_SHARE
    return int(min(len(fit.star), len(near), as_bright))


def _best_of_others(fit: _Fit, lens: _Lens, start: Camera, free: np.ndarray,
                    centroids: Centroids, star: np.ndarray, onboard: OnboardCatalog) -> _Fit:
    """Return the fit that matches most stars, of those from other values of the distortion."""
    for k1 in _OTHER_K1:
        if np.count_nonzero(fit.star >= 0) >= _GOOD_SHARE * _possible(fit, onboard):
            break
        try:
            bent = replace(start, distortion=(k1, *start.distortion[1:]))
            rough = _grow(_Lens(bent.lens, lens.quaternion), bent.lens,
                          np.append(free[:-1], _K1_HELD), centroids, star, onboard)
            other = _grow(rough.lens, start.lens, free, centroids, rough.star, onboard)
        except CameraError:
            continue
        if np.count_nonzero(other.star >= 0) > np.count_nonzero(fit.star >= 0):
            fit = other
    return fit


def _centred(fit: _Fit, start: Lens, free: np.ndarray, centroids: Centroids,
             onboard: OnboardCatalog) -> _Fit:
    """Return the fit with the principal point of start, where its stars do not deny that."""
    model = fit.lens.model
    off = np.array([model.cx - start.cx, model.cy - start.cy]) / start.width
    covariance = fit.covariance[_CENTRE_TERMS, _CENTRE_TERMS]
    if not (fit.star >= 0).any() or off @ np.linalg.solve(covariance, off) > _CERTAIN_SQUARE:
        return fit
    held = free.copy()
    held[_CENTRE_TERMS] *= _HELD
    return _Fit(*_fitted(fit.lens, start, held, centroids, fit.star, onboard), fit.star)


def _fitted(lens: _Lens, start: Lens, free: np.ndarray, centroids: Centroids, star: np.ndarray,
            onboard: OnboardCatalog) -> tuple[_Lens, np.ndarray, float]:
    """Return lens, covariance and error of fit_lens(); CameraError for one that folds."""
    row = np.flatnonzero(star >= 0)
    model, quaternion, covariance, error_px = fit_lens(
        *lens, start, free, onboard.direction[star[row]], centroids.uv[row],
        centroids.sigma_px[row])
    if folds(model):
        raise CameraError(f'distortion k1 {model.terms[0]:.2g} folds the image over itself')
    return _Lens(model, quaternion), covariance, error_px


def _gate(error_px: float, model: Lens, onboard: OnboardCatalog, least_px: float) -> float:
    """Return the matching radius in px."""
    per_px = len(onboard) / (model.fx * model.fy) / (4 * np.pi * onboard.sky_share)
    chance_px = np.sqrt(_MOST_CHANCE / (np.pi * per_px))
    return float(max(min(max(_GATE_SIGMAS * error_px, least_px), chance_px), _LEAST_GATE_PX))


def _match(lens: _Lens, centroids: Centroids, onboard: OnboardCatalog, gate_px: float
           ) -> np.ndarray:
    """Return the catalogue star (N,) of each centroid within the gate, one to one, -1 for none."""
    near, uv = stars_in_image(*lens, onboard.direction)
    star = np.full(len(centroids), -1)
    index, found = nearest_pairs(centroids.uv, uv, gate_px)
    star[index] = near[found]
    return star


def _residuals(lens: _Lens, centroids: Centroids, onboard: OnboardCatalog, star: np.ndarray
               ) -> np.ndarray:
    """Return image minus catalogue (N, 2) in px, NaN where not matched."""
    residual = np.full((len(star), 2), np.nan)
    row = star >= 0
    residual[row] = centroids.uv[row] - linearised(
        *lens, onboard.direction[star[row]], RADIAL)[0]
    return residual


def _reason(fit: _Fit, camera: Camera, nominal: Camera, focal_error: float, first: int,
            possible: int) -> str:
    """Return why a fitted lens is rejected, empty if it is not."""
    matched = int(np.count_nonzero(fit.star >= 0))
    if matched < max(_KEPT_SHARE * first, _LEAST_MATCHES):
        return f'the fitted lens loses {first - matched} of the {first} stars that led to it'
    if matched < _LEAST_SHARE * possible:
        return f'the fitted lens explains {matched} of {possible} stars: not the whole image'
    if fit.error_px > _MOST_RESIDUAL * camera.width:
        return f'the fitted lens leaves residuals of {fit.error_px:.2g} px'
    sigma_px = np.sqrt(_middle_covariance(fit).diagonal()[:2].max()) / camera.pixel_rad
    if sigma_px > _MOST_ERROR_PX:
        return (f'{matched} stars leave the lens open: the middle of the image is uncertain by '
                f'{sigma_px:.2g} px')
    # The width of the image, from edge to edge, with the distortion or without it.
    seen, given = camera.seen_x_rad, nominal.fov_x_rad
    off = min(abs(camera.radius(fov / 2) / camera.radius(given / 2) - 1)
              for fov in (seen, camera.fov_x_rad))
    # So many stars determine the lens by themselves: the given field of view is the error.
    limit = focal_error * (_LIMIT_FACTOR if matched >= _SURE_MATCHES else 1)
    if off > limit + _LIMIT_SIGMAS * np.sqrt(fit.covariance[3, 3]):
        return (f'the field of view that fits, {np.degrees(seen):.4g} deg, is '
                f'{100 * off:.2g} % off')
    return ''


def _attitude(fit: _Fit, residual: np.ndarray, centroids: Centroids) -> AttitudeEstimate:
    """Return the attitude of the lens, its covariance with a free lens."""
    (model, quaternion), row = fit.lens, fit.star >= 0
    square = np.sum(residual[row] ** 2, axis=1)
    sigma = np.maximum(np.hypot(centroids.sigma_px[row], LEAST_ERROR_PX), fit.error_px)
    return AttitudeEstimate(
        -quaternion if quaternion[3] < 0 else quaternion, fit.covariance[:3, :3],
        int(np.count_nonzero(row)), np.sqrt(square / (model.fx * model.fy)),
        float(np.sum(square / sigma ** 2)))


def _middle_covariance(fit: _Fit) -> np.ndarray:
    """Return the covariance (3, 3) of the attitude of the middle of the image."""
    model, quaternion = fit.lens
    axes = middle_axes(model)
    middle = multiply(quaternion, axes)
    # Focal length and distortion hardly move the middle of the image.
    parameters = len(fit.covariance)
    partial = np.zeros((3, parameters))
    partial[:, :3] = matrix_from_quaternion(conjugate(axes))
    for axis in range(parameters)[_CENTRE_TERMS]:
        step = np.zeros(parameters)
        step[axis] = _STEP
        other, turned = changed(model, quaternion, step)
        partial[:, axis] = attitude_error(multiply(turned, middle_axes(other)), middle) / _STEP
    return partial @ fit.covariance @ partial.T
