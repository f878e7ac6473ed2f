# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars of all frames, and the turns of the frames that explain their residuals."""

from typing import NamedTuple

import numpy as np


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
