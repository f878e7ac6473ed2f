# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Noise of the pixels of a star: background, photons and the error of the star's model."""

from typing import NamedTuple

from startracker_ros.core.compiled import compiled


class NoiseModel(NamedTuple):
    """
    Variance of a pixel: background + gain_dn * flux + (model_error * flux)^2.

    gain_dn is the DN of one photo-electron (Poisson noise), model_error the relative error of a
    Gaussian as the point spread function of a real lens.
    """

    gain_dn: float
    model_error: float = 0.0


@compiled
def pixel_variance(noise: NoiseModel, background: float, flux: float) -> float:
    """Return the variance in DN^2 of a pixel with this flux in DN and background variance."""
    flux = max(flux, 0.0)
    return background + flux * (noise.gain_dn + noise.model_error ** 2 * flux)


def initial_noise_model(level_dn: float, variance: float) -> NoiseModel:
    """Return the initial model: the background is photons, as in a camera without offset."""
    return NoiseModel(variance / max(level_dn, 3 * variance ** 0.5))
