# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors of stars that repeat: with the place in the field, with the phase in the pixel.

The residuals of the stars of a frame are those of its attitude, which is eliminated, and patterns
A c that all frames share. The coefficients c are least squares; their covariance is by leaving out
one star at a time (jackknife), as what a star is off by, in the catalogue or by a neighbour, is in
all of its frames.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats
from startracker_ros.core.camera.model import Camera
from startracker_ros.tools.night.intervals import CONFIDENCE, Interval, normal, root, UNKNOWN


# --- the stars of all frames, and the turns that explain their residuals ---


class Stars(NamedTuple):
    """
    Catalogue stars that the images should show, one row for each star and frame.

    frame (N,) and star (N,) are indices; seen (N,) is whether a centroid is near. uv (N, 2) px is
    where it is expected, residual (N, 2) px measured minus predicted by the fitted motion, NaN if
    not seen. jacobian (N, 2, 3) are px by a turn of the sensor in rad; refraction (N, 2) px is
    what the air shifts.
    """

    frame: np.ndarray
    star: np.ndarray
    magnitude: np.ndarray
    uv: np.ndarray
    seen: np.ndarray
    residual: np.ndarray
    sigma_px: np.ndarray
    jacobian: np.ndarray
    refraction: np.ndarray

    def select(self, chosen: np.ndarray) -> 'Stars':
        """Return the rows of a mask (N,)."""
        return Stars(*(column[chosen] for column in self))


def frame_normals(stars: Stars) -> np.ndarray:
    """Return the information (F, 3, 3) 1/rad^2 of the stars of each frame about its attitude."""
    normal = np.zeros((int(stars.frame.max(initial=-1)) + 1, 3, 3))
    np.add.at(normal, stars.frame, np.einsum(
        'n,nki,nkj->nij', stars.sigma_px ** -2, stars.jacobian, stars.jacobian))
    return normal


def turns_of(stars: Stars, shifts: np.ndarray) -> np.ndarray:
    """Return the turns (F, 3, C) rad of the frames that fit shifts (N, 2, C) px best."""
    normal = frame_normals(stars)
    gradient = np.zeros((len(normal), 3, shifts.shape[-1]))
    np.add.at(gradient, stars.frame, np.einsum(
        'n,nki,nkc->nic', stars.sigma_px ** -2, stars.jacobian, shifts))
    return np.linalg.pinv(normal, hermitian=True) @ gradient


def without_turns(stars: Stars, shifts: np.ndarray) -> np.ndarray:
    """Return shifts (N, 2, C) px less what turns of the frames explain of them."""
    return shifts - np.einsum('nki,nic->nkc', stars.jacobian,
                              turns_of(stars, shifts)[stars.frame])


# --- patterns ---

HIGHEST_DEGREE = 3
_STARS_PER_COEFFICIENT = 2
PHASE_COLUMNS = 4


class Pattern(NamedTuple):
    """Coefficients (C,) of columns (N, 2, C) px and their covariance (C, C), by so many stars."""

    columns: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    stars: int

    def part(self, chosen: slice) -> 'Pattern':
        """Return the pattern of some coefficients."""
        return Pattern(self.columns[..., chosen], self.coefficients[chosen],
                       self.covariance[chosen, chosen], self.stars)

    @property
    def shift_px(self) -> np.ndarray:
        """Return the shifts (N, 2) px of the stars."""
        return self.columns @ self.coefficients

    @property
    def found(self) -> bool:
        """Return whether the coefficients are more than their errors explain (Hotelling's T^2)."""
        count = len(self.coefficients)
        square = self.coefficients @ np.linalg.pinv(self.covariance) @ self.coefficients
        return bool(square * (self.stars - count) / (count * (self.stars - 1))
                    > stats.f.ppf(CONFIDENCE, count, self.stars - count))

    def rms(self, linear: np.ndarray) -> Interval:
        """
        Return the rms of the values linear c, linear (..., C), without what the errors of c add.

        For M = mean linear^T linear the square c^T M c is too large by tr(M S) on average, S the
        covariance; its variance is 4 c^T M S M c + 2 tr(M S M S) for the true c.
        """
        flat = linear.reshape(-1, linear.shape[-1])
        square = flat.T @ flat / max(len(flat), 1)
        c, product = self.coefficients, square @ self.covariance
        noise = 2 * float(np.trace(product @ product))
        variance = max(4 * float(c @ product @ square @ c) - noise, noise)
        return root(float(c @ square @ c - np.trace(product)), variance ** 0.5, self.found)


def fit_pattern(stars: Stars, columns: np.ndarray) -> Pattern | None:
    """Return the pattern of columns (N, 2, C) in residuals; None of too few different stars."""
    names, star = np.unique(stars.star, return_inverse=True)
    count = columns.shape[-1]
    if len(names) < _STARS_PER_COEFFICIENT * count:
        return None
    left = without_turns(stars, np.concatenate(
        [columns, stars.residual[..., None]], axis=-1))
    design, residual = left[..., :-1], left[..., -1]
    weight = stars.sigma_px ** -2
    information = np.zeros((len(names), count, count))
    gradient = np.zeros((len(names), count))
    np.add.at(information, star, np.einsum('n,nki,nkj->nij', weight, design, design))
    np.add.at(gradient, star, np.einsum('n,nki,nk->ni', weight, design, residual))
    total, sums = information.sum(axis=0), gradient.sum(axis=0)
    coefficients = np.linalg.pinv(total, hermitian=True) @ sums
    others = np.array([np.linalg.pinv(total - own, hermitian=True) @ (sums - part)
                       for own, part in zip(information, gradient)])
    deviation = others - others.mean(axis=0)
    covariance = (len(names) - 1) / len(names) * deviation.T @ deviation
    return Pattern(columns, coefficients, covariance, len(names))


def field_columns(uv: np.ndarray, camera: Camera, degree: int, *, shear: bool = True
                  ) -> np.ndarray:
    """
    Return smooth shifts (N, 2, C) px: polynomials of the place, but for shift and rotation.

    Of degree 1 these are the scale and, with shear, two shears. Places are in half diagonals of
    the image.
    """
    half = np.hypot(camera.width, camera.height) / 2
    x, y = ((uv - [(camera.width - 1) / 2, (camera.height - 1) / 2]) / half).T
    zero = np.zeros_like(x)
    columns = [(x, y)] + ([(x, -y), (y, x)] if shear else [])
    for total in range(2, degree + 1):
        for power in range(total + 1):
            term = x ** power * y ** (total - power)
            columns += [(term, zero), (zero, term)]
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def phase_columns(uv: np.ndarray) -> np.ndarray:
    """Return sine and cosine (N, 2, 4) of the place in the pixel, of each axis."""
    u, v = 2 * np.pi * uv.T
    zero = np.zeros_like(u)
    return np.stack([np.stack(column, axis=-1) for column in (
        (np.sin(u), zero), (np.cos(u), zero), (zero, np.sin(v)), (zero, np.cos(v)))], axis=-1)


def field_degree(stars: Stars, camera: Camera) -> int:
    """Return the highest degree for which there are enough different stars, 0 for none."""
    count = len(np.unique(stars.star))
    for degree in range(HIGHEST_DEGREE, 0, -1):
        coefficients = field_columns(np.zeros((1, 2)), camera, degree).shape[-1]
        if count >= _STARS_PER_COEFFICIENT * (coefficients + PHASE_COLUMNS):
            return degree
    return 0


def single_coefficient(stars: Stars, camera: Camera, column: np.ndarray, degree: int
                       ) -> Interval:
    """
    Return the factor of a shift (N, 2) px in the residuals.

    Beside it scale, terms of higher degree and pixel phases are fitted, and no shear: the lens of
    the camera file is believed to have none.
    """
    pattern = fit_pattern(stars, np.concatenate(
        [column[..., None], phase_columns(stars.uv),
         field_columns(stars.uv, camera, degree, shear=False)], axis=-1)) if degree else None
    if pattern is None:
        return UNKNOWN
    return normal(float(pattern.coefficients[0]), float(pattern.covariance[0, 0]) ** 0.5,
                  pattern.stars - 1)
