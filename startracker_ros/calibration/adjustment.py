"""
Camera and attitudes together, as they fit the known stars of many frames best.

Bundle adjustment with the sky as calibration target. Each frame has an attitude of its own,
which is eliminated: its part of the normal equations is projected out, frame by frame, and
only the few parameters of the lens remain (Triggs et al., Bundle Adjustment - A Modern
Synthesis, 2000, section 6; the projection of Golub and Pereyra 1973).

One focal length is estimated: the pixels of a sensor repeat more evenly than stars tell, and
what would pass for a difference of fx and fy on the ground is the refraction of the air.
The ratio fy / fx stays that of the camera to begin with.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from startracker_ros.camera.model import Camera, CameraError
from startracker_ros.maths.rotation import (
    matrix_from_quaternion, multiply, quaternion_from_rotation_vector)

TERMS = {'focal': ('focal',), 'k1': ('k1',), 'centre': ('cx', 'cy'), 'tangential': ('p1', 'p2'),
         'k2': ('k2',), 'k3': ('k3',)}
"""What can be estimated, in the order it is tried, and the parameters of each: focal length and
principal point in px, distortion as plumb_bob has it."""

_PARAMETERS = ('focal', 'cx', 'cy', 'k1', 'k2', 'p1', 'p2', 'k3')
# Stars this many sigmas from their places are taken for wrong: one good star in 3000.
_CUT_SIGMAS = 4.0
_MOST_STEPS = 50
# From this step on weights stay and rejected stars stay out: nothing goes to and fro for ever.
_SETTLING_STEPS = 10
# A step of every parameter below this share of its error is the end.
_DONE_SIGMAS = 0.01
_TURN_RAD = 1e-5
_NO_INFORMATION = 1e-12


class CalibrationError(ValueError):
    """Stars from which no calibration follows; the text says why."""


@dataclass(frozen=True)
class KnownStars:
    """
    Star images of all frames and the stars that they are.

    uv (N, 2) px; sigma_px (N,) 1-sigma error per axis; icrf (N, 3) unit vectors; frame (N,)
    the index of the frame that each belongs to.
    """

    uv: np.ndarray
    sigma_px: np.ndarray
    icrf: np.ndarray
    frame: np.ndarray

    def __len__(self) -> int:
        return len(self.uv)

    def select(self, chosen: np.ndarray) -> 'KnownStars':
        """Return the stars of a mask (N,) or of indices."""
        return KnownStars(self.uv[chosen], self.sigma_px[chosen], self.icrf[chosen],
                          self.frame[chosen])


@dataclass(frozen=True)
class Adjustment:
    """
    A camera that fits, and how well.

    quaternions (F, 4) are q_icrf_from_sensor; terms are those estimated and covariance (P, P)
    that of their parameters, in the order of `parameters`; kept (N,) is False for stars
    taken for wrong; residual_px (N, 2) is image minus model; extra_px is the error that
    the residuals show beyond sigma_px, per axis, which covariance includes.
    """

    camera: Camera
    quaternions: np.ndarray
    terms: tuple[str, ...]
    covariance: np.ndarray
    kept: np.ndarray
    residual_px: np.ndarray
    extra_px: float

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters estimated."""
        return _parameters_of(self.terms)

    @property
    def values(self) -> dict[str, float]:
        """Return the parameters estimated."""
        return {name: _values(self.camera)[name] for name in self.parameters}

    @property
    def sigmas(self) -> dict[str, float]:
        """Return the 1-sigma errors of the parameters estimated."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.covariance)).tolist()))


def adjust(camera: Camera, stars: KnownStars, quaternions: np.ndarray, terms: tuple[str, ...], *,
           reject: bool = True) -> Adjustment:
    """
    Return the camera and the attitudes (F, 4) that fit the stars best.

    Gauss-Newton from a camera and attitudes that are nearly right; only the terms named are
    estimated. Weights are those of sigma_px and of an extra error, the same for all stars,
    that makes the residuals as large as promised. With reject, stars far off are left out.
    CalibrationError when no camera fits.
    """
    names = _parameters_of(terms)
    frames = len(quaternions)
    freedom = 2 * len(stars) - len(names) - 3 * frames
    if freedom <= 0:
        raise CalibrationError(f'{len(stars)} stars in {frames} images: too few for '
                               f'{len(names)} parameters of the camera and each attitude')
    kept = np.ones(len(stars), bool)
    settled = False
    for step in range(_MOST_STEPS):
        direction = _sensor_directions(stars, quaternions)
        residual = stars.uv - camera.project(direction)
        if not np.isfinite(residual).all():
            raise CalibrationError('no camera fits: a star stands behind it')
        square = np.einsum('ij,ij->i', residual, residual)
        if step < _SETTLING_STEPS:
            extra = _extra_error(square[kept], stars.sigma_px[kept], freedom / (2 * len(stars)))
        variance = stars.sigma_px ** 2 + extra ** 2
        near = square <= _CUT_SIGMAS ** 2 * variance
        if reject:
            kept = near if step < _SETTLING_STEPS else kept & near
        weight = kept / np.sqrt(variance)
        lens, turn, covariance = _step(
            residual * weight[:, None], _lens_partials(camera, direction, names) * weight[
                :, None, None], _turn_partials(camera, direction) * weight[:, None, None],
            stars.frame, frames)
        if settled:
            return Adjustment(camera, quaternions, terms, covariance, kept, residual, extra)
        try:
            camera = _moved(camera, dict(zip(names, lens)))
        except CameraError as error:
            raise CalibrationError(f'no camera fits: {error}') from error
        quaternions = multiply(quaternions, quaternion_from_rotation_vector(turn))
        # A rejected star tells nothing of the step; the turns follow the lens.
        settled = bool(np.all(np.abs(lens) <= _DONE_SIGMAS * np.sqrt(np.diag(covariance)))
                       and np.abs(turn).max() < _DONE_SIGMAS * camera.pixel_rad)
    raise CalibrationError(f'no camera fits: {_MOST_STEPS} steps did not end')


def _parameters_of(terms: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for term in terms for name in TERMS[term])


def _values(camera: Camera) -> dict[str, float]:
    return dict(zip(_PARAMETERS, (camera.fx, camera.cx, camera.cy, *camera.distortion)))


def _moved(camera: Camera, change: dict[str, float]) -> Camera:
    """Return the camera with its parameters changed; CameraError when there is none such."""
    value = _values(camera)
    for name, by in change.items():
        value[name] += float(by)
    return replace(camera, fx=value['focal'], fy=value['focal'] * camera.fy / camera.fx,
                   cx=value['cx'], cy=value['cy'],
                   distortion=tuple(value[name] for name in _PARAMETERS[3:]))


def _sensor_directions(stars: KnownStars, quaternions: np.ndarray) -> np.ndarray:
    matrix = matrix_from_quaternion(quaternions)[stars.frame]
    return np.einsum('nij,ni->nj', matrix, stars.icrf)


def _lens_partials(camera: Camera, direction: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return how the pixels of directions (N, 3) move with the parameters, (N, 2, P)."""
    x, y = (direction[:, :2] / direction[:, 2:]).T
    r2 = x * x + y * y
    aspect = np.array([1.0, camera.fy / camera.fx])
    place = np.stack([x, y], -1)
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    focal = camera.fx * aspect
    partial = {
        'focal': (camera.project(direction) - [camera.cx, camera.cy]) / camera.fx,
        'cx': np.stack([ones, zeros], -1), 'cy': np.stack([zeros, ones], -1),
        'k1': focal * place * r2[:, None], 'k2': focal * place * (r2 ** 2)[:, None],
        'p1': focal * np.stack([2 * x * y, r2 + 2 * y * y], -1),
        'p2': focal * np.stack([r2 + 2 * x * x, 2 * x * y], -1),
        'k3': focal * place * (r2 ** 3)[:, None]}
    return np.stack([partial[name] for name in names], -1) if names else np.empty((len(x), 2, 0))


def _turn_partials(camera: Camera, direction: np.ndarray) -> np.ndarray:
    """Return how pixels move as the sensor turns about its axes, (N, 2, 3) in px / rad."""
    # A turn of the sensor by d moves a direction by -d x direction.
    moves = [np.cross(direction, axis) * _TURN_RAD for axis in np.eye(3)]
    return np.stack([(camera.project(direction + move) - camera.project(direction - move))
                     / (2 * _TURN_RAD) for move in moves], -1)


def _step(residual: np.ndarray, lens: np.ndarray, turn: np.ndarray, frame: np.ndarray,
          frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the change of the lens (P,), of the attitudes (F, 3), and the lens covariance.

    residual (N, 2), lens (N, 2, P) and turn (N, 2, 3) are divided by the errors.
    """
    count = lens.shape[2]
    rows = [np.flatnonzero(frame == i) for i in range(frames)]
    information, gradient = np.zeros((count, count)), np.zeros(count)
    parts = []
    for row in rows:
        a, b = lens[row].reshape(2 * len(row), count), turn[row].reshape(-1, 3)
        r = residual[row].ravel()
        basis = np.linalg.qr(b)[0]
        clear = a - basis @ (basis.T @ a)
        information += clear.T @ clear
        gradient += clear.T @ r
        parts.append((a, b, r))
    # Scaled, as a focal length stands beside k3; what no star tells gets an enormous error.
    scale = np.sqrt(np.diag(information))
    scale[scale == 0] = 1.0
    scale = np.outer(scale, scale)
    covariance = np.linalg.inv(information / scale + _NO_INFORMATION * np.eye(count)) / scale
    change = covariance @ gradient
    turns = np.array([np.linalg.lstsq(b, r - a @ change)[0] for a, b, r in parts])
    return change, turns.reshape(frames, 3), covariance


def _extra_error(square: np.ndarray, sigma_px: np.ndarray, share: float) -> float:
    """
    Return the error in px, per axis, that residuals show beyond sigma_px (N,).

    square (N,) are the squared residuals of both axes in px^2; a fit leaves only a share of
    the true errors. By the median, which few wrong stars do not move: half of all stars have
    squares below 2 ln 2 variances of one axis.
    """
    def excess(extra: float) -> float:
        return float(np.median(square / (sigma_px ** 2 + extra ** 2))) / share - 2 * np.log(2)
    if excess(0.0) <= 0:
        return 0.0
    return float(brentq(excess, 0.0, np.sqrt(square.max() / share)))
