"""Noise of the pixels under a star: background, photons, and what the model does not tell."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

PRIOR_PIXELS = 10.0  # weight of the first guess of the gain
ROUNDS = 3
OUTLIER = 16.0  # variances


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel: background + gain_dn * light + (model_error * light)^2.

    gain_dn is the DN of one photo-electron (Poisson noise), model_error the relative error of the
    point spread function, which no Gaussian of a real lens is without.
    """

    gain_dn: float
    model_error: float = 0.0

    def variance(self, background: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Return DN^2 for light in DN (the broadcast shape of both)."""
        light = np.maximum(light, 0)
        return background + light * (self.gain_dn + self.model_error ** 2 * light)


def first_noise_model(level_dn: float, variance: float) -> NoiseModel:
    """Return the model of a background that is all light: a camera without offset."""
    return NoiseModel(variance / max(level_dn, 3 * variance ** 0.5))


def refine_noise_model(noise: NoiseModel, residual: np.ndarray, light: np.ndarray,
                       background: np.ndarray, kept: np.ndarray) -> NoiseModel:
    """Fit gain and model error to the residuals of all stars, by iterated least squares.

    residual, light and background variance (M,) of the used pixels; kept (M,) is the share of
    its noise that the star fit left in the residual. The first gain counts as
    PRIOR_PIXELS pixels, so that one or two faint stars change nothing.
    """
    square = residual ** 2 / kept
    prior = noise.gain_dn
    for _ in range(ROUNDS):
        variance = noise.variance(background, light)
        excess = np.minimum(square, OUTLIER * variance) - background
        rows = np.stack([light, light ** 2], 1) / variance[:, None]
        rows = np.concatenate([rows, [[np.sqrt(PRIOR_PIXELS) / prior, 0]]])
        wanted = np.append(excess / variance, np.sqrt(PRIOR_PIXELS))
        scale = np.linalg.norm(rows, axis=0)
        scale[scale == 0] = 1
        (gain, square_error), _ = nnls(rows / scale, wanted)
        noise = NoiseModel(gain / scale[0], float(np.sqrt(square_error / scale[1])))
    return noise
