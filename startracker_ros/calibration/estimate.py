"""
The calibration of a camera: rounds of matching and adjusting, and what the data tell.

The distortion found so far says where stars near the edges must stand, so they are matched
anew with each better camera until hardly a star comes or goes.

Focal length, principal point and k1 are estimated whenever the stars determine them. A
further distortion term is taken in when it differs from zero beyond doubt: one that does
not would only carry noise into the corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from startracker_ros.calibration.adjustment import (
    adjust, Adjustment, CalibrationError, KnownStars, TERMS)
from startracker_ros.calibration.matching import match_stars, View
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.maths.rotation import attitude_error

MIN_STARS = 30
MIN_FRAME_STARS = 5
"""A frame of four tells nothing of the lens beyond a few turns of its own attitude."""

_ALWAYS = ('focal', 'centre', 'k1')
# A term is taken in when chance would make it as large once in a thousand cameras.
_CHANCE = 1e-3
# What counts as determined: 1 sigma of the focal length, of the principal point in widths of
# the image, and of a distortion term by what it does in the corner, in px.
_FOCAL_ERROR = 2e-3
_CENTRE_ERROR = 0.02
_CORNER_ERROR_PX = 1.0
_FIRST_GATE_PX = 5.0
# Never so wide that many spots find a wrong star: in mean distances of the stars.
_FIRST_GATE_SPACING = 0.2
_GATE_SIGMAS = 5.0
_MOST_ROUNDS = 15
_SETTLED = 0.01  # share of the stars that may come or go in the last round
# Turned by less, in widths of the image, frames show the same stars at the same pixels.
_SAME_POINTING = 0.03
_CELLS = 8


@dataclass(frozen=True)
class Calibration:
    """
    A calibrated camera and what it rests on.

    adjustment holds the camera, the parameters and their covariance; its frames are those
    of `frames` (F,), indices of the views. held says of each term why it was not estimated;
    the covariance takes it as zero, or as it was to begin with. stars are those used; the
    residuals (N, 2) in px of the same stars are residual_px of this camera, pinhole_px of
    an ideal one with the best focal length, and left_out_px of cameras calibrated without
    the frame of the star (NaN with two frames).
    """

    adjustment: Adjustment
    frames: np.ndarray
    held: dict[str, str]
    stars: KnownStars
    residual_px: np.ndarray
    pinhole_px: np.ndarray
    left_out_px: np.ndarray

    @property
    def camera(self) -> Camera:
        """Return the calibrated camera."""
        return self.adjustment.camera


def calibrate(views: Sequence[View], camera: Camera, places: StarPlaces,
              terms: Sequence[str] = ()) -> Calibration:
    """
    Return the camera that took the views.

    camera and the attitudes of the views need to be nearly right: within a few px in most of
    the image. terms names what is estimated beside the focal length, all of it; without
    any the data decide. CalibrationError says what the stars do not determine.
    """
    frames = np.arange(len(views))
    quaternions = np.array([view.quaternion for view in views]).reshape(-1, 4)
    spacing = camera.pixel_rad ** -1 * np.sqrt(4 * np.pi / max(1, len(places)))
    gate_px = first_gate = min(_FIRST_GATE_PX, _FIRST_GATE_SPACING * spacing)
    # What the data do not speak for is no distortion, whatever was taken for it before.
    start = camera if terms else replace(camera, distortion=(0.0,) * 5)
    before = 0
    for _ in range(_MOST_ROUNDS):
        if len(frames) < 2:
            raise CalibrationError(
                f'{len(frames)} identified images, at least 2 are needed: in a single one the '
                'principal point is not determined beside the attitude, nor is it seen whether '
                'the calibration holds for any other')
        stars = match_stars(camera, places, [views[int(i)] for i in frames], quaternions,
                            gate_px)
        enough = np.bincount(stars.frame, minlength=len(frames)) >= MIN_FRAME_STARS
        if not enough.all():
            # Wrongly identified, or hardly a star: the frame goes, with all it says.
            frames, quaternions = frames[enough], quaternions[enough]
            continue
        _refuse_poor(stars, camera, quaternions)
        found, held = _choose(start, stars, quaternions, terms)
        camera, quaternions = found.camera, found.quaternions
        enough = np.bincount(stars.frame[found.kept], minlength=len(frames)) >= MIN_FRAME_STARS
        if not enough.all():
            frames, quaternions = frames[enough], quaternions[enough]
            continue
        if abs(len(stars) - before) <= len(stars) * _SETTLED:
            return _report(found, held, stars, frames)
        before = len(stars)
        typical = np.hypot(np.median(stars.sigma_px), found.extra_px)
        gate_px = min(first_gate, _GATE_SIGMAS * typical)
    raise CalibrationError(f'no camera fits: the stars that it explains still change after '
                           f'{_MOST_ROUNDS} rounds')


def covered_percent(camera: Camera, uv: np.ndarray) -> float:
    """Return the share of the cells of the image that hold one of the pixels (N, 2), in %."""
    return 100 * len(np.unique(cells(camera, uv))) / _CELLS ** 2


def cells(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """Return which of the 8 x 8 cells of the image each of the pixels (N, 2) lies in, (N,)."""
    place = ((uv + 0.5) / [camera.width, camera.height] * _CELLS).astype(int)
    return np.clip(place, 0, _CELLS - 1) @ [_CELLS, 1]


def moved(camera: Camera, quaternion: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return how far stars move in the image to attitudes (F, 4), in widths of the image."""
    turn = attitude_error(others, quaternion)
    across = np.hypot(turn[..., 0], turn[..., 1]) * camera.fx
    about = np.abs(turn[..., 2]) * np.hypot(camera.width, camera.height) / 2
    return np.maximum(across, about) / camera.width


def _refuse_poor(stars: KnownStars, camera: Camera, quaternions: np.ndarray) -> None:
    """Raise CalibrationError when the frames can tell nothing, whatever the term."""
    if len(stars) < MIN_STARS:
        raise CalibrationError(
            f'{len(stars)} identified stars, at least {MIN_STARS} are needed: focal length, '
            'principal point and distortion are not determined')
    if moved(camera, quaternions[0], quaternions).max() < _SAME_POINTING:
        raise CalibrationError(
            'all images have the same pointing and roll, so every star stands at the same '
            'pixels: the principal point is not determined beside the attitude; turn the '
            'camera between the images')


def _choose(camera: Camera, stars: KnownStars, quaternions: np.ndarray,
            wanted: Sequence[str]) -> tuple[Adjustment, dict[str, str]]:
    """Return the adjustment of the terms wanted, or of those that the stars determine."""
    found = adjust(camera, stars, quaternions, ('focal',))
    reason = _undetermined(found)
    if reason:
        raise CalibrationError(reason)
    held = {}
    for term in TERMS:
        if term in found.terms or (wanted and term not in wanted):
            continue
        try:
            trial = adjust(found.camera, stars, found.quaternions, (*found.terms, term))
            reason = _undetermined(trial)
        except CalibrationError as error:
            reason = f'is not determined: {error}'
        if not reason and not wanted and term not in _ALWAYS and not _significant(trial, term):
            reason = 'does not differ from zero'
        if not reason:
            found = trial
        elif wanted:
            raise CalibrationError(f'{term}: {reason}')
        else:
            held[term] = reason
    return found, held


def _undetermined(found: Adjustment) -> str:
    """Return which parameter has too large an error, empty for none."""
    camera = found.camera
    corner = np.tan(camera.corner_angle_rad)
    for name, sigma in found.sigmas.items():
        if name == 'focal':
            share, text = sigma / camera.fx / _FOCAL_ERROR, f'{sigma:.2g} px'
        elif name in ('cx', 'cy'):
            share, text = sigma / camera.width / _CENTRE_ERROR, f'{sigma:.2g} px'
        else:
            power = {'k1': 3, 'k2': 5, 'k3': 7, 'p1': 2, 'p2': 2}[name]
            at_corner = sigma * camera.fx * corner ** power
            share, text = at_corner / _CORNER_ERROR_PX, f'{at_corner:.2g} px in the corner'
        if not share < 1:
            return (f'{name} is not determined: its 1 sigma error is {text}; take more images, '
                    'with stars all over the field')
    return ''


def _significant(found: Adjustment, term: str) -> bool:
    """Return whether a term differs from zero beyond chance (Wald's test)."""
    place = [found.parameters.index(name) for name in TERMS[term]]
    value = np.array([found.values[name] for name in TERMS[term]])
    statistic = value @ np.linalg.solve(found.covariance[np.ix_(place, place)], value)
    return bool(statistic > chi2.isf(_CHANCE, len(place)))


def _report(found: Adjustment, held: dict[str, str], stars: KnownStars,
            frames: np.ndarray) -> Calibration:
    """Return the calibration with the residuals of other cameras for the same stars."""
    stars, residual_px = stars.select(found.kept), found.residual_px[found.kept]
    camera = found.camera
    ideal = replace(camera, cx=(camera.width - 1) / 2, cy=(camera.height - 1) / 2,
                    distortion=(0.0,) * 5)
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
