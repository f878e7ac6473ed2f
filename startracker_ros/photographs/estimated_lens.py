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
of native/src/blind/lens_growth.h.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.calibration.matching import nearest_pairs
from startracker_ros.core.camera.model import Camera, CameraError, middle_axes
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply, rotate)
from startracker_ros.photographs.ladder import Attempt
from startracker_ros.photographs.lens_fit import (
    camera_of, changed, FISHEYE_TERMS, LEAST_ERROR_PX, lens_of, LensError, SkyAndSpots,
    stars_in_image)

# Prior standard deviations: relative pixel ratio, principal point (of the width), k1.
_RATIO, _CENTRE, _K1 = 0.05, 0.04, 0.25
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
# A match of a fisheye where the lens is less certain than this share of the error of a spot, 1 px
# at least, needs so many matches, as a share, among so many nearest stars of the catalogue.
_OPEN, _LEAST_OPEN_PX, _LEAST_AROUND, _AROUND = 0.45, 1.0, 0.25, 8
_LIMIT_SIGMAS = 3.0
_SURE_MATCHES, _LIMIT_FACTOR = 12, 2.0


@dataclass(frozen=True)
class EstimatedLens:
    """
    A fitted camera and its attitude.

    The covariance of attitude contains the errors of the lens; star (N,) is the catalogue index
    of each centroid, -1 for none; residual_px (N,) NaN there. sigma_px is the error per axis that
    the residuals show; rejected says why it is not to be used, empty if it is. error is that of
    its pixels, None of a lens that is not fitted.
    """

    camera: Camera
    attitude: AttitudeEstimate
    focal_ratio: float
    star: np.ndarray
    residual_px: np.ndarray
    sigma_px: float
    rejected: str
    error: LensError | None = None

    @property
    def matched(self) -> int:
        """Return the number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


def estimate_lens(attempt: Attempt, focal_error: float) -> EstimatedLens:
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
                    + ([*FISHEYE_TERMS] if fisheye else [_K1]))
    held = np.array([1.0] * 4 + [_HELD] * (len(free) - 4))
    quaternion = identification.attitude.quaternion
    try:
        # A lens at the limit of what a camera can have folds its image at another focal length.
        start = start.with_focal_ratio(identification.focal_ratio)
        image = _Image(start, centroids, onboard)
        lens = lens_of(start.native, quaternion)
        fit = image.grow(lens, lens['camera'], free, star)
        if np.count_nonzero(fit.star >= 0) < _FEW_MATCHES and start.fov_x_rad < _NARROW_RAD:
            fit = image.grow(lens, lens['camera'], free * held, star)
        elif not fisheye:
            fit = image.best_of_others(fit, lens, free, star)
            if start.fov_x_rad < _NARROW_RAD:
                fit = image.centred(fit, lens['camera'], free)
        camera = camera_of(fit.lens, start.distortion_model)
    except CameraError as error:
        return EstimatedLens(start, identification.attitude, 1.0, star,
                          np.full(len(star), np.nan), 0.0, str(error))
    residual = image.residuals(fit, camera)
    return EstimatedLens(camera, _attitude(fit, residual, centroids), camera.fx / nominal.fx,
                      fit.star, np.hypot(*residual.T), fit.error_px,
                      _reason(fit, camera, nominal, focal_error, first, image.possible(fit)),
                      LensError(camera, fit.covariance))


class _Fit(NamedTuple):
    """An st_fitted_lens of so many parameters, and stars (N,)."""

    lens: np.ndarray
    parameters: int
    star: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Return that of the parameters, (P, P)."""
        covariance: np.ndarray = self.lens['covariance'][:self.parameters, :self.parameters]
        return covariance

    @property
    def error_px(self) -> float:
        """Return the error per axis."""
        return float(self.lens['error_px'])


class _Image:
    """An image of a camera, whose lens is fitted to its centroids and stars."""

    def __init__(self, start: Camera, centroids: Centroids, onboard: OnboardCatalog) -> None:
        self._start, self._centroids, self._onboard = start, centroids, onboard
        self._seen = SkyAndSpots(onboard.direction, centroids.uv, centroids.sigma_px)

    def grow(self, lens: np.ndarray, start: np.ndarray, free: np.ndarray, star: np.ndarray
             ) -> _Fit:
        """
        Return the lens that is fitted and matched in turn until its stars (N,) stay.

        CameraError when it folds the image.
        """
        for iteration in range(_MAX_ITERATIONS):
            lens = self._fitted(lens, start, free, star)
            error_px, before, growing = float(lens['error_px']), star, iteration < _GROWING
            if self._start.model.equidistant:
                star = self._among_others(lens, len(free), self._seen.gated(
                    lens, len(free), max(error_px, _LEAST_GATE_PX / _GATE_SIGMAS)))
            else:
                star = self._matched(lens, self._gate(
                    lens, _FIRST_GATE_PX if growing else _LEAST_GATE_PX))
            if (np.count_nonzero(star >= 0) < _LEAST_MATCHES
                    or not growing and np.array_equal(star, before)):
                break
        return _Fit(lens, len(free), star)

    def possible(self, fit: _Fit) -> int:
        """
        Return how many stars may match: those of the image or of the catalogue in it.

        Where few spots are stars, those are the brightest of the catalogue: it counts as deep as
        most matches are.
        """
        near, _ = stars_in_image(fit.lens, self._onboard.direction)
        as_bright = np.count_nonzero(near <= self._deepest(fit.star)) / _KEPT_SHARE
        return int(min(len(fit.star), len(near), as_bright))

    def best_of_others(self, fit: _Fit, lens: np.ndarray, free: np.ndarray, star: np.ndarray
                       ) -> _Fit:
        """Return the fit that matches most stars, of those from other values of the distortion."""
        for k1 in _OTHER_K1:
            if np.count_nonzero(fit.star >= 0) >= _GOOD_SHARE * self.possible(fit):
                break
            try:
                bent = replace(
                    self._start, distortion=(k1, *self._start.distortion[1:])).native
                rough = self.grow(lens_of(bent, lens['quaternion']), bent,
                                  np.append(free[:-1], _K1_HELD), star)
                other = self.grow(rough.lens, lens['camera'], free, rough.star)
            except CameraError:
                continue
            if np.count_nonzero(other.star >= 0) > np.count_nonzero(fit.star >= 0):
                fit = other
        return fit

    def centred(self, fit: _Fit, start: np.ndarray, free: np.ndarray) -> _Fit:
        """Return the fit with the principal point of start, where its stars do not deny that."""
        off = np.array([fit.lens['camera'][name] - start[name] for name in ('cx_px', 'cy_px')])
        off /= start['width_px']
        covariance = fit.covariance[_CENTRE_TERMS, _CENTRE_TERMS]
        if not (fit.star >= 0).any() or off @ np.linalg.solve(covariance, off) > _CERTAIN_SQUARE:
            return fit
        held = free.copy()
        held[_CENTRE_TERMS] *= _HELD
        return fit._replace(lens=self._fitted(fit.lens, start, held, fit.star))

    def residuals(self, fit: _Fit, camera: Camera) -> np.ndarray:
        """Return image minus catalogue (N, 2) in px, NaN where not matched."""
        residual = np.full((len(fit.star), 2), np.nan)
        row = fit.star >= 0
        residual[row] = self._centroids.uv[row] - camera.project(rotate(
            conjugate(fit.lens['quaternion']), self._onboard.direction[fit.star[row]]))
        return residual

    def _fitted(self, lens: np.ndarray, start: np.ndarray, free: np.ndarray, star: np.ndarray
                ) -> np.ndarray:
        """Return the fitted lens; CameraError for one that folds."""
        found = self._seen.fitted(lens, start, free, star)
        if found['folds']:
            k1 = found['camera']['distortion'][0]
            raise CameraError(f'distortion k1 {k1:.2g} folds the image over itself')
        return found

    def _among_others(self, lens: np.ndarray, parameters: int, star: np.ndarray) -> np.ndarray:
        """
        Return the star (N,) of each centroid, -1 where it alone would decide what the lens is.

        There hardly any star around it is matched: it is mostly a lamp in the gate of a star that
        is behind hills or clouds.
        """
        direction, matched = self._onboard.direction, np.flatnonzero(star >= 0)
        near, _ = stars_in_image(lens, direction)
        near = near[near <= self._deepest(star)]
        if len(near) <= _AROUND:
            return star
        sigma_px = LensError(camera_of(lens, self._start.distortion_model),
                             lens['covariance'][:parameters, :parameters]).sigma_px(
                                 self._centroids.uv[matched])
        matched = matched[~(sigma_px < _OPEN * max(float(lens['error_px']), _LEAST_OPEN_PX))]
        _, around = cKDTree(direction[near]).query(direction[star[matched]], _AROUND + 1)
        around = near[around]
        others = around != star[matched, None]
        share = (np.isin(around, star) & others).sum(axis=1) / others.sum(axis=1)
        found = star.copy()
        found[matched[share < _LEAST_AROUND]] = -1
        return found

    def _deepest(self, star: np.ndarray) -> int:
        """Return the star as deep as most matches, -1 for none: the brightest one is 0."""
        matched = np.sort(star[star >= 0])
        return int(matched[int(_KEPT_SHARE * (len(matched) - 1))]) if len(matched) else -1

    def _gate(self, lens: np.ndarray, least_px: float) -> float:
        """Return the matching radius in px."""
        camera, onboard = lens['camera'], self._onboard
        per_px = (len(onboard) / (camera['fx_px'] * camera['fy_px'])
                  / (4 * np.pi * onboard.sky_share))
        chance_px = np.sqrt(_MOST_CHANCE / (np.pi * per_px))
        return float(max(min(max(_GATE_SIGMAS * lens['error_px'], least_px), chance_px),
                         _LEAST_GATE_PX))

    def _matched(self, lens: np.ndarray, gate_px: float) -> np.ndarray:
        """Return the star (N,) of each centroid within the gate, one to one, -1 for none."""
        near, uv = stars_in_image(lens, self._onboard.direction)
        star = np.full(len(self._centroids), -1)
        index, found = nearest_pairs(self._centroids.uv, uv, gate_px)
        star[index] = near[found]
        return star


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
    sigma_px = np.sqrt(_middle_covariance(fit, camera).diagonal()[:2].max()) / camera.pixel_rad
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
    quaternion, camera, row = fit.lens['quaternion'], fit.lens['camera'], fit.star >= 0
    square = np.sum(residual[row] ** 2, axis=1)
    sigma = np.maximum(np.hypot(centroids.sigma_px[row], LEAST_ERROR_PX), fit.error_px)
    return AttitudeEstimate(
        -quaternion if quaternion[3] < 0 else quaternion.copy(), fit.covariance[:3, :3].copy(),
        int(np.count_nonzero(row)), np.sqrt(square / (camera['fx_px'] * camera['fy_px'])),
        float(np.sum(square / sigma ** 2)))


def _middle_covariance(fit: _Fit, camera: Camera) -> np.ndarray:
    """Return the covariance (3, 3) of the attitude of the middle of the image."""
    axes = camera.middle_axes
    middle = multiply(fit.lens['quaternion'], axes)
    # Focal length and distortion hardly move the middle of the image.
    partial = np.zeros((3, fit.parameters))
    partial[:, :3] = matrix_from_quaternion(conjugate(axes))
    for axis in range(fit.parameters)[_CENTRE_TERMS]:
        step = np.zeros(fit.parameters)
        step[axis] = _STEP
        other = changed(fit.lens, step)
        partial[:, axis] = attitude_error(
            multiply(other['quaternion'], middle_axes(other['camera'])), middle) / _STEP
    return partial @ fit.covariance @ partial.T
