# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The band of a camera: what it measures of stars, against their magnitudes V, Hp and G.

A star of frame f, with V and the difference G - V of its colour, gives the flux F at a distance r
from the centre of the image, in half diagonals:

    -2.5 log F = z_f + V + c (G - V) + d r^2.

The zero points z_f, the colour term c (0 in V, 1 in G) and the dimming d in the corners are fitted
by least squares. Stars that the catalogue has as variables and those beyond 3 robust standard
deviations, blends among them, are left out of the fit, not of the scatter.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.calibration.adjustment import MatchedStars
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BANDS, G_BAND, magnitude_in_band
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

_REJECT_SIGMAS = 3.0
_ITERATIONS = 10
# Stars on each fitted parameter.
_MIN_STARS_EACH = 3


@dataclass(frozen=True)
class Photometry:
    """
    The colour term c with its 1-sigma error and the dimming d in mag.

    scatter_mag is the rms residual in mag of all stars in this band, band_scatter_mag in the
    bands V, Hp and G, with a zero point for each frame alone. All are NaN for too few stars.
    """

    colour_term: float
    colour_term_sigma: float
    corner_mag: float
    scatter_mag: float
    band_scatter_mag: dict[str, float]


def fit_band(stars: MatchedStars, camera: Camera) -> Photometry:
    """Return the band that fits the fluxes of matched stars best."""
    colours, variation_mag = _of_catalog(stars.hip, camera)
    measured = stars.flux > 0
    steady = variation_mag[measured] == 0
    frames = np.unique(stars.frame[measured], return_inverse=True)[1]
    zero_points = np.eye(frames.max(initial=-1) + 1)[frames]
    if np.count_nonzero(steady) < _MIN_STARS_EACH * (zero_points.shape[1] + 2):
        return Photometry(np.nan, np.nan, np.nan, np.nan, dict.fromkeys(BANDS, np.nan))
    magnitude, colour = stars.magnitude[measured], colours[measured]
    instrumental = -2.5 * np.log10(stars.flux[measured])
    middle = (np.array([camera.width, camera.height]) - 1) / 2
    r2 = np.sum((stars.uv[measured] - middle) ** 2, axis=1) / np.sum(middle ** 2)
    band_scatter = {
        band: _fit(zero_points, instrumental - magnitude_in_band(magnitude, colour, band),
                   steady)[2]
        for band in BANDS}
    redness = magnitude_in_band(np.zeros(len(colour)), colour, G_BAND)
    value, sigma, scatter = _fit(np.column_stack([zero_points, redness, r2]),
                                 instrumental - magnitude, steady)
    return Photometry(float(value[-2]), float(sigma[-2]), float(value[-1]), scatter, band_scatter)


def _of_catalog(hip: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the colours and the variation_mag (N,) of stars of the catalogue."""
    catalog = camera_catalog(camera)
    order = np.argsort(catalog.hip)
    row = order[np.searchsorted(catalog.hip, hip, sorter=order)]
    return catalog.bp_rp[row], catalog.variation_mag[row]


def _fit(design: np.ndarray, observed: np.ndarray, steady: np.ndarray
         ) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Return parameters (P,), their errors (P,) and the rms residual of all observed (N,).

    Fitted are those of steady (N,) that are not outliers.
    """
    used = steady
    for _ in range(_ITERATIONS):
        value = np.linalg.lstsq(design[used], observed[used], rcond=None)[0]
        residual = observed - design @ value
        within = steady & (np.abs(residual) <= _REJECT_SIGMAS * SIGMA_PER_MAD * np.median(
            np.abs(residual)))
        if (within == used).all():
            break
        used = within
    variance = np.sum(residual[used] ** 2) / max(np.count_nonzero(used) - design.shape[1], 1)
    covariance = variance * np.linalg.pinv(design[used].T @ design[used])
    return value, np.sqrt(np.diag(covariance)), float(np.sqrt(np.mean(residual ** 2)))
