# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The calibration of a camera: matching and bundle adjustment in turn, selection of terms.

A better distortion model brings stars near the edges into the gate, so matching is repeated
with each adjusted camera until the set of stars is nearly constant.

Focal length, principal point and k1, of a fisheye k2 too, are estimated whenever the stars
determine them. A further distortion term is estimated only when it differs significantly from
zero; otherwise it would only add noise in the corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from startracker_ros.core.calibration.adjustment import (
    adjust, Adjustment, CalibrationError, MatchedStars, TERMS)
from startracker_ros.core.calibration.matching import match_stars, View
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import attitude_error

MIN_STARS = 30
MIN_FRAME_STARS = 5
"""Four stars hardly determine more than the attitude of their own frame."""

_BASE_TERMS = ('focal', 'centre', 'k1')
# Of a fisheye at once: without its distortion no focal length fits.
_FISHEYE_TERMS = ('focal', 'k1', 'centre', 'k2')
# Significance level of a distortion term: false alarms per camera.
_SIGNIFICANCE = 1e-3
# Largest 1 sigma of a determined parameter: focal length (relative), principal point (relative
# to the image width), and distortion term by its effect in the corner.
_MAX_FOCAL_ERROR = 2e-3
_MAX_CENTRE_ERROR = 0.02
_MAX_CORNER_ERROR_PX = 1.0
_FIRST_GATE_PX = 5.0
# Upper bound of the first gate in mean star separations, against wrong matches.
_FIRST_GATE_SPACING = 0.2
_GATE_SIGMAS = 5.0
_MAX_ITERATIONS = 15
_CONVERGED = 0.01  # largest change of the number of stars in the last iteration, relative
# Frames with smaller shifts of the stars, in widths of the image, have the same pointing.
_SAME_POINTING = 0.03
_CELLS = 8


@dataclass(frozen=True)
class Calibration:
    """
    A calibrated camera with its stars and residuals.

    Attributes:
        adjustment: Parameters and their covariance (Adjustment), and the camera.
        frames: (F,) int, indices of the images that are used.
        held: Why each term that is not estimated is held at zero or its initial value, by name.
            The covariance takes these as exact.
        stars: The N stars of all frames (MatchedStars).
        residual_px: (N, 2) float64, px, image minus catalogue with this camera.
        pinhole_px: (N, 2) the same with an ideal camera of the best focal length.
        left_out_px: (N, 2) the same with cameras calibrated without the frame of the star; NaN
            for two frames.

    """

    adjustment: Adjustment
    frames: np.ndarray
    held: dict[str, str]
    stars: MatchedStars
    residual_px: np.ndarray
    pinhole_px: np.ndarray
    left_out_px: np.ndarray

    @property
    def camera(self) -> Camera:
        """The calibrated `Camera`."""
        return self.adjustment.camera


def calibrate(views: Sequence[View], camera: Camera, onboard: OnboardCatalog,
              terms: Sequence[str] = ()) -> Calibration:
    """
    Return the calibration of the camera of the views.

    The initial camera and the attitudes of the views must be accurate to a few px in most of
    the image. terms are estimated besides the focal length; without any the significant terms
    are selected. Of a fisheye one view is enough. CalibrationError names what the stars do not
    determine.
    """
    frames = np.arange(len(views))
    quaternions = np.array([view.quaternion for view in views]).reshape(-1, 4)
    spacing = camera.pixel_rad ** -1 * np.sqrt(4 * np.pi / max(1, len(onboard)))
    gate_px = first_gate = min(_FIRST_GATE_PX, _FIRST_GATE_SPACING * spacing)
    # With automatic selection a term that is not significant is zero.
    start = camera if terms else camera.ideal()
    before = 0
    for _ in range(_MAX_ITERATIONS):
        if len(frames) < (1 if camera.model.equidistant else 2):
            raise CalibrationError(
                f'{len(frames)} identified images, at least 2 are needed: in a single one the '
                'principal point and the attitude are not determined separately, and the '
                'calibration cannot be checked with another image')
        stars = match_stars(camera, onboard, [views[int(i)] for i in frames], quaternions,
                            gate_px)
        enough = np.bincount(stars.frame, minlength=len(frames)) >= MIN_FRAME_STARS
        if not enough.all():
            # Wrongly identified frames, or frames with hardly any stars.
            frames, quaternions = frames[enough], quaternions[enough]
            continue
        if len(stars) < MIN_STARS:
            raise CalibrationError(
                f'{len(stars)} identified stars, at least {MIN_STARS} are needed: focal length, '
                'principal point and distortion are not determined')
        found, held = _select_terms(start, stars, quaternions, terms)
        _check_geometry(found, quaternions)
        camera, quaternions = found.camera, found.quaternions
        enough = np.bincount(stars.frame[found.used], minlength=len(frames)) >= MIN_FRAME_STARS
        if not enough.all():
            frames, quaternions = frames[enough], quaternions[enough]
            continue
        if abs(len(stars) - before) <= len(stars) * _CONVERGED:
            return _calibration(found, held, stars, frames)
        before = len(stars)
        typical = np.hypot(np.median(stars.sigma_px), found.extra_px)
        gate_px = min(first_gate, _GATE_SIGMAS * typical)
    raise CalibrationError(f'no camera fits: the matched stars still change after '
                           f'{_MAX_ITERATIONS} iterations')


def covered_percent(camera: Camera, uv: np.ndarray) -> float:
    """Return the percentage of the cells of the image that contain any of the pixels (N, 2)."""
    return 100 * len(np.unique(cells(camera, uv))) / _CELLS ** 2


def cells(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """Return the index (N,) of the cell, of 8 x 8 in the image, of each pixel (N, 2)."""
    column_row = ((uv + 0.5) / [camera.width, camera.height] * _CELLS).astype(int)
    return np.clip(column_row, 0, _CELLS - 1) @ [_CELLS, 1]


def star_shift(camera: Camera, quaternion: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the shift (F,) of the stars to attitudes (F, 4), in widths of the image."""
    rotation = attitude_error(others, quaternion)
    across = np.hypot(rotation[..., 0], rotation[..., 1]) * camera.fx
    about = np.abs(rotation[..., 2]) * np.hypot(camera.width, camera.height) / 2
    return np.maximum(across, about) / camera.width


def _check_geometry(found: Adjustment, quaternions: np.ndarray) -> None:
    """Raise CalibrationError for frames (F, 4) of one pointing; one of a fisheye has it all."""
    if found.camera.model.equidistant and 'centre' in found.terms:
        return
    if star_shift(found.camera, quaternions[0], quaternions).max() < _SAME_POINTING:
        raise CalibrationError(
            'all images have the same pointing and roll, so every star is at the same pixels: '
            'the principal point and the attitude are not determined separately; rotate the '
            'camera between the images')


def _select_terms(camera: Camera, stars: MatchedStars, quaternions: np.ndarray,
                  wanted: Sequence[str]) -> tuple[Adjustment, dict[str, str]]:
    """Return the adjustment of the wanted terms or, without any, of the significant ones."""
    found = None
    if camera.model.equidistant and not wanted:
        found = _determined(camera, stars, quaternions, _FISHEYE_TERMS)
    if found is None:
        found = adjust(camera, stars, quaternions, ('focal',))
        reason = _undetermined(found)
        if reason:
            raise CalibrationError(reason)
    held = {}
    for term in TERMS:
        if term in found.terms or (wanted and term not in wanted):
            continue
        if not set(TERMS[term]) <= {'cx', 'cy', *camera.model.coefficients}:
            if wanted:
                raise CalibrationError(f'{term}: {camera.distortion_model} does not have it')
            continue
        try:
            trial = adjust(found.camera, stars, found.quaternions, (*found.terms, term))
            reason = _undetermined(trial)
        except CalibrationError as error:
            reason = f'is not determined: {error}'
        if not reason and not wanted and term not in _BASE_TERMS and not _significant(trial, term):
            reason = 'does not differ from zero'
        if not reason:
            found = trial
        elif wanted:
            raise CalibrationError(f'{term}: {reason}')
        else:
            held[term] = reason
    return found, held


def _determined(camera: Camera, stars: MatchedStars, quaternions: np.ndarray,
                terms: tuple[str, ...]) -> Adjustment | None:
    """Return the adjustment of terms, None where the stars do not determine all of them."""
    try:
        found = adjust(camera, stars, quaternions, terms)
    except CalibrationError:
        return None
    return None if _undetermined(found) else found


def _undetermined(found: Adjustment) -> str:
    """Return the parameter whose error is too large, as text; empty if there is none."""
    camera = found.camera
    corner = camera.radius(camera.corner_angle_rad)
    for name, sigma in found.sigmas.items():
        if name == 'focal':
            ratio, text = sigma / camera.fx / _MAX_FOCAL_ERROR, f'{sigma:.2g} px'
        elif name in ('cx', 'cy'):
            ratio, text = sigma / camera.width / _MAX_CENTRE_ERROR, f'{sigma:.2g} px'
        else:
            power = {'k1': 3, 'k2': 5, 'k3': 7, 'k4': 9, 'p1': 2, 'p2': 2}[name]
            at_corner = sigma * camera.fx * corner ** power
            ratio, text = at_corner / _MAX_CORNER_ERROR_PX, f'{at_corner:.2g} px in the corner'
        if not ratio < 1:
            return (f'{name} is not determined: its 1 sigma error is {text}; take more images, '
                    'with stars all over the field')
    return ''


def _significant(found: Adjustment, term: str) -> bool:
    """Return whether a term differs significantly from zero (Wald test)."""
    index = [found.parameters.index(name) for name in TERMS[term]]
    value = np.array([found.values[name] for name in TERMS[term]])
    statistic = value @ np.linalg.solve(found.covariance[np.ix_(index, index)], value)
    return bool(statistic > gate(_SIGNIFICANCE, len(index)))


def _calibration(found: Adjustment, held: dict[str, str], stars: MatchedStars,
                 frames: np.ndarray) -> Calibration:
    """Return the calibration with the residuals of the stars for all three cameras."""
    stars, residual_px = stars.select(found.used), found.residual_px[found.used]
    camera = found.camera
    ideal = replace(camera.ideal(), cx=(camera.width - 1) / 2, cy=(camera.height - 1) / 2)
    pinhole = adjust(ideal, stars, found.quaternions, ('focal',), reject=False)
    left_out_px = np.full(stars.uv.shape, np.nan)
    for i in range(len(frames) if len(frames) > 2 else 0):
        here = stars.frame == i
        others = replace(stars.select(~here), frame=stars.frame[~here] - (stars.frame[~here] > i))
        without = adjust(camera, others, np.delete(found.quaternions, i, axis=0), found.terms,
                         reject=False)
        alone = replace(stars.select(here), frame=np.zeros(np.count_nonzero(here), int))
        left_out_px[here] = adjust(without.camera, alone, found.quaternions[i:i + 1], (),
                                   reject=False).residual_px
    return Calibration(found, frames, held, stars, residual_px, pinhole.residual_px, left_out_px)
