# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Figures of a calibration: parameters with errors, residuals before and after."""

import numpy as np
from startracker_ros.core.calibration.estimate import Calibration, cells, covered_percent
from startracker_ros.core.calibration.photometry import fit_band
from startracker_ros.core.maths.rotation import ARCSEC


def figures(calibration: Calibration, mask: np.ndarray) -> dict[str, object]:
    """
    Return the rms residuals in arcsec of the stars selected by a mask (N,).

    pinhole_arcsec is before and calibrated_arcsec after the calibration; left_out_arcsec is
    with the camera calibrated from the other images.
    """
    arcsec = calibration.camera.pixel_rad / ARCSEC
    values: dict[str, object] = {'stars': int(np.count_nonzero(mask))}
    for name, residual_px in _residuals(calibration).items():
        square = np.sum(residual_px[mask] ** 2, axis=-1)
        values[f'{name}_arcsec'] = (arcsec * float(np.sqrt(square.mean()))
                                    if len(square) else float('nan'))
    return values


def summary(calibration: Calibration) -> dict[str, object]:
    """
    Return the parameters with their 1-sigma errors and the residuals of all images.

    ..._lens_arcsec are the errors of each camera model: the rms over the cells of the image of
    the mean residual in a cell, in which the errors of the centroids average out. colour_term,
    corner_mag and ..._mag are those of photometry.py.
    """
    found = calibration.adjustment
    stars = calibration.stars
    values: dict[str, object] = {}
    for name, value in found.values.items():
        values[name], values[f'{name}_sigma'] = float(value), found.sigmas[name]
    values['held'] = '; '.join(
        f'{term}: {reason}' for term, reason in calibration.held.items()) or 'nothing'
    values['images'] = len(calibration.frames)
    values['covered_percent'] = covered_percent(calibration.camera, stars.uv)
    values.update(figures(calibration, np.ones(len(stars), bool)))
    arcsec = calibration.camera.pixel_rad / ARCSEC
    for name, residual_px in _residuals(calibration).items():
        values[f'{name}_lens_arcsec'] = arcsec * _rms_of_cells(
            cells(calibration.camera, stars.uv), residual_px, stars.sigma_px)
    band = fit_band(stars, calibration.camera)
    values.update(colour_term=band.colour_term, colour_term_sigma=band.colour_term_sigma,
                  corner_mag=band.corner_mag, scatter_mag=band.scatter_mag)
    values.update({f'scatter_{name.lower()}_mag': scatter
                   for name, scatter in band.band_scatter_mag.items()})
    return values


def sentence(calibration: Calibration) -> str:
    """Return the parameters and residuals in one line."""
    values = summary(calibration)
    parameters = ', '.join(
        f'{name} {values[name]:.6g} +- {values[f"{name}_sigma"]:.2g}'
        for name in calibration.adjustment.parameters)
    return (f'{parameters}; residual {values["calibrated_arcsec"]:.2f} arcsec, '
            f'{values["pinhole_arcsec"]:.2f} of a pinhole, {values["left_out_arcsec"]:.2f} of '
            f'frames left out; {values["stars"]} stars in {values["images"]} frames')


def _residuals(calibration: Calibration) -> dict[str, np.ndarray]:
    return {'pinhole': calibration.pinhole_px, 'calibrated': calibration.residual_px,
            'left_out': calibration.left_out_px}


def _rms_of_cells(cell: np.ndarray, residual_px: np.ndarray, sigma_px: np.ndarray) -> float:
    """Return the rms, over both axes, of the weighted mean of residual_px (N, 2) per cell."""
    weight = sigma_px ** -2
    total = np.bincount(cell, weight)
    sums = np.array([np.bincount(cell, weight * axis) for axis in residual_px.T])
    means = sums[:, total > 0] / total[total > 0]
    return float(np.sqrt(np.mean(np.sum(means ** 2, axis=0))))
