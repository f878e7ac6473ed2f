"""Gain and model error of the noise, out of what the fits of all stars leave."""

import numpy as np
from startracker_ros.centroid.gaussian_fit import Fit, leverage
from startracker_ros.centroid.noise import NoiseModel
from startracker_ros.centroid.windows import Windows
from startracker_ros.compiled import fused, reordered

PRIOR_PIXELS = 10.0  # weight of the first guess of the gain
ROUNDS = 3
OUTLIER = 16.0  # variances
LEAST_KEPT = 0.1  # of the noise of a pixel, left in its residual


def refine_noise_model(noise: NoiseModel, fit: Fit, windows: Windows,
                       chosen: np.ndarray) -> NoiseModel:
    """
    Fit gain and model error to the residuals of chosen stars (K,), by iterated least squares.

    A residual is short of the noise that its star's fit has absorbed. The first gain counts
    as PRIOR_PIXELS pixels, so that one or two faint stars change nothing.
    """
    return NoiseModel(*_refine(noise, fit, windows, chosen))


@reordered
def _refine(noise: NoiseModel, fit: Fit, windows: Windows, chosen: np.ndarray
            ) -> tuple[float, float]:
    """Return the fields of NoiseModel."""
    _, count, filled = windows.data.shape
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    absorbed, pixels = np.empty((count, filled), np.float32), 0
    size = np.count_nonzero(chosen) * count * filled
    square, light = np.empty(size, np.float32), np.empty(size, np.float32)
    background = np.empty(size, np.float32)
    for i in range(len(chosen)):
        if chosen[i]:
            leverage(fit, windows, i, columns, rows, absorbed)
            for y in range(count):
                for x in range(filled):
                    if windows.used[i, y, x]:
                        square[pixels] = ((fit.own[i, y, x] - fit.light[i, y, x]) ** 2
                                          / max(1 - absorbed[y, x], np.float32(LEAST_KEPT)))
                        light[pixels] = fit.light[i, y, x]
                        background[pixels] = windows.variance[i]
                        pixels += 1
    gain, model_error, prior = noise.gain_dn, noise.model_error, noise.gain_dn
    for _ in range(ROUNDS):
        a, b, c = PRIOR_PIXELS / prior ** 2, 0.0, 0.0
        p, q = PRIOR_PIXELS / prior, 0.0
        for k in range(pixels):
            variance = background[k] + light[k] * (gain + model_error ** 2 * light[k])
            excess = min(square[k], OUTLIER * variance) - background[k]
            first = light[k] / variance
            second, excess = light[k] * first, excess / variance
            a, b, c = a + first * first, b + first * second, c + second * second
            p, q = p + first * excess, q + second * excess
        gain, model_error = _solve(a, b, c, p, q)
    return gain, model_error


@fused
def _solve(a: float, b: float, c: float, p: float, q: float) -> tuple[float, float]:
    """Return x and the root of y that solve [a b; b c] [x y] = [p q] best with x, y >= 0."""
    determinant = a * c - b * b
    if determinant > 0:
        x, y = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        if x >= 0 and y >= 0:
            return x, np.sqrt(y)
    x, y = max(p, 0.0) / a, max(q, 0.0) / c if c > 0 else 0.0
    return (x, 0.0) if a * x ** 2 >= c * y ** 2 else (0.0, np.sqrt(y))
