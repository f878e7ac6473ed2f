"""Gaussian point spread function, integrated over the pixels, fitted to all stars at once."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from startracker_ros.centroid.noise import NoiseModel
from startracker_ros.centroid.windows import Windows

U, V, FLUX, LEVEL, SIGMA = range(5)  # columns of the parameters
MAX_STEP_PX = 0.7
SIGMA_RANGE_PX = (0.2, 8.0)
ENOUGH_PX = 1e-4  # a step shorter than this ends the iteration


@dataclass(frozen=True)
class Fit:
    """Fitted stars; window arrays are (K, n, n).

    parameters (K, 5): u, v px, flux DN, level DN above the mesh background, sigma px;
    covariance (K, p, p) of the first p = 4 or 5 of them; light: model of the star itself;
    own: data without neighbours and level; variance: noise of the pixels, DN^2;
    leverage: the share of a pixel's noise that the fit absorbs; freedom (K,): pixels
    less parameters; chi2 (K,).
    """

    parameters: np.ndarray
    covariance: np.ndarray
    light: np.ndarray
    own: np.ndarray
    variance: np.ndarray
    leverage: np.ndarray
    freedom: np.ndarray
    chi2: np.ndarray


def profile(centre: np.ndarray, sigma: np.ndarray, first: np.ndarray, count: int
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the share of light in `count` pixels from `first` (K,) on, along one axis.

    All (K, count): the share, its derivative by centre and its derivative by sigma.
    """
    edge = first[:, None] + np.arange(count + 1) - 0.5
    z = (edge - centre[:, None]) / sigma[:, None]
    density = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * sigma[:, None])
    below, slope = 0.5 * erf(z * np.sqrt(0.5)), z * density
    return (below[:, 1:] - below[:, :-1], density[:, :-1] - density[:, 1:],
            slope[:, :-1] - slope[:, 1:])


def star_light(parameters: np.ndarray, corner: np.ndarray, count: int) -> np.ndarray:
    """Return the light (K, n, n) in DN of stars with parameters (K, 5)."""
    u, v, flux, _, sigma = parameters.T
    across = profile(u, sigma, corner[:, 0], count)[0]
    down = profile(v, sigma, corner[:, 1], count)[0]
    return flux[:, None, None] * down[:, :, None] * across[:, None, :]


def neighbour_light(parameters: np.ndarray, windows: Windows) -> np.ndarray:
    """Return the light (K, n, n) which the other stars throw into each window."""
    light = np.zeros_like(windows.data)
    target, source = windows.neighbours.T
    np.add.at(light, target, star_light(
        parameters[source], windows.corner[target], light.shape[1]))
    return light


def fit_stars(windows: Windows, start: np.ndarray, noise: NoiseModel, *,
              free_sigma: bool = False, iterations: int = 12) -> Fit:
    """Weighted least squares by Gauss-Newton from start (K, 5); sigma is free on request.

    The weights follow the model, not the data, which would bias the flux low. Neighbours
    are fitted in turns: each star against the data less the others' last model.
    """
    stars, count = windows.data.shape[:2]
    free = 5 if free_sigma else 4
    limit = np.array([MAX_STEP_PX, MAX_STEP_PX, np.inf, np.inf, 0.3])[:free]
    lengths = [U, V, SIGMA] if free_sigma else [U, V]
    parameters = start.copy()
    jacobian = np.empty((stars, free, count, count))
    jacobian[:, LEVEL] = 1
    flat = jacobian.reshape(stars, free, count * count)
    # a star without usable pixels, or without light, must not make the matrix singular
    ridge = 1e-12 * np.eye(free)
    for iteration in range(iterations + 1):
        u, v, flux, level, sigma = parameters.T
        across, across_u, across_sigma = profile(u, sigma, windows.corner[:, 0], count)
        down, down_v, down_sigma = profile(v, sigma, windows.corner[:, 1], count)
        along, scaled = across[:, None, :], (flux[:, None] * down)[:, :, None]
        np.multiply(scaled, across_u[:, None, :], out=jacobian[:, U])
        np.multiply((flux[:, None] * down_v)[:, :, None], along, out=jacobian[:, V])
        np.multiply(down[:, :, None], along, out=jacobian[:, FLUX])
        if free_sigma:
            jacobian[:, SIGMA] = (scaled * across_sigma[:, None, :]
                                  + (flux[:, None] * down_sigma)[:, :, None] * along)
        light = scaled * along
        shone, own = light, windows.data - level[:, None, None]
        if len(windows.neighbours):
            others = neighbour_light(parameters, windows)
            shone, own = light + others, own - others
        variance = noise.variance(windows.variance[:, None, None], shone)
        weight = windows.used / variance
        residual = own - light
        weighted = flat * weight.reshape(stars, 1, count * count)
        normal = (weighted @ flat.swapaxes(1, 2)) * (1 + ridge) + ridge
        if iteration == iterations:
            break
        slope = weighted @ residual.reshape(stars, count * count, 1)
        step = np.clip(np.linalg.solve(normal, slope)[..., 0], -limit, limit)
        parameters[:, :free] += step
        parameters[:, FLUX] = np.maximum(parameters[:, FLUX], 1e-3)
        if free_sigma:
            parameters[:, SIGMA] = np.clip(parameters[:, SIGMA], *SIGMA_RANGE_PX)
        if np.abs(step[:, lengths]).max(initial=0) < ENOUGH_PX:
            break
    covariance = np.linalg.inv(normal)
    leverage = ((covariance @ flat) * weighted).sum(1).reshape(light.shape)
    return Fit(parameters, covariance, light, own, variance, leverage,
               windows.used.sum((1, 2)) - free,
               (residual * residual * weight).sum((1, 2)))
