"""What a calibration says for itself: parameters with errors, residuals before and after."""

import numpy as np

from startracker_ros.calibration.adjustment import extra_error
from startracker_ros.calibration.estimate import Calibration, covered_percent
from startracker_ros.rotation import ARCSEC


def figures(calibration: Calibration, chosen: np.ndarray) -> dict[str, object]:
    """Return the residuals, rms in arcsec, of a choice (N,) of the stars.

    pinhole_arcsec is before, calibrated_arcsec after, left_out_arcsec with the camera that the
    other images give.
    """
    arcsec = calibration.camera.pixel_rad / ARCSEC
    values: dict[str, object] = {'stars': int(np.count_nonzero(chosen))}
    for name, square in _squares(calibration).items():
        values[f'{name}_arcsec'] = (arcsec * float(np.sqrt(square[chosen].mean()))
                                    if values['stars'] else float('nan'))
    return values


def summary(calibration: Calibration) -> dict[str, object]:
    """Return the parameters with their 1-sigma errors and the residuals of all images.

    The ..._lens_arcsec are the parts of the residuals that the errors of the centroids do
    not explain: what each camera model leaves over.
    """
    found = calibration.adjustment
    stars = calibration.stars
    values: dict[str, object] = {}
    for name, value in found.values.items():
        values[name], values[f'{name}_sigma'] = float(value), found.sigmas[name]
    values['held'] = '; '.join(calibration.held.values()) or 'nothing'
    values['images'] = len(calibration.frames)
    values['covered_percent'] = covered_percent(calibration.camera, stars.uv)
    values.update(figures(calibration, np.ones(len(stars), bool)))
    arcsec = calibration.camera.pixel_rad / ARCSEC
    for name, square in _squares(calibration).items():
        # Both axes together, as the residuals are.
        values[f'{name}_lens_arcsec'] = (np.sqrt(2) * arcsec * extra_error(square, stars.sigma_px)
                                         if np.isfinite(square).all() else float('nan'))
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


def _squares(calibration: Calibration) -> dict[str, np.ndarray]:
    residuals = {'pinhole': calibration.pinhole_px, 'calibrated': calibration.residual_px,
                 'left_out': calibration.left_out_px}
    return {name: np.sum(residual ** 2, axis=-1) for name, residual in residuals.items()}
