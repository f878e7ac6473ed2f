"""Noise of the pixels under a star: background, photons, and what the model does not tell."""

from typing import NamedTuple

from startracker_ros.compiled import compiled


class NoiseModel(NamedTuple):
    """
    Variance of a pixel: background + gain_dn * light + (model_error * light)^2.

    gain_dn is the DN of one photo-electron (Poisson noise), model_error the relative error of the
    point spread function, which no Gaussian of a real lens is without.
    """

    gain_dn: float
    model_error: float = 0.0


@compiled
def pixel_variance(noise: NoiseModel, background: float, light: float) -> float:
    """Return DN^2 of a pixel with light in DN above a background of this variance."""
    light = max(light, 0.0)
    return background + light * (noise.gain_dn + noise.model_error ** 2 * light)


def first_noise_model(level_dn: float, variance: float) -> NoiseModel:
    """Return the model of a background that is all light: a camera without offset."""
    return NoiseModel(variance / max(level_dn, 3 * variance ** 0.5))
