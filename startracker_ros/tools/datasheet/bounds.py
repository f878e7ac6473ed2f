# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The Cramer-Rao bound of an attitude, from the expected image of each star.

A pixel of the image of a star of F electrons expects F g electrons above a noise of variance
B + F g, with g the Gaussian PSF integrated over the pixel and averaged over the motion in the
exposure. The Fisher information of the position along an axis is the sum of
(F dg/da)^2 / (B + F g) over the pixels (Winick, J. Opt. Soc. Am. A 3, 1986, for a known flux and
background: no estimator has a smaller error).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import erf
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.detector import DetectorOptions

_FLUXES = np.geomspace(1.0, 1e7, 57)
_OFFSETS_PX = (-0.375, -0.125, 0.125, 0.375)
_REACH_SIGMAS = 5.0
_STEP_RAD = 1e-6


@dataclass(frozen=True)
class StarImage:
    """
    The image of a star that moves by streak_px: 1 / px^2 of information at each of _FLUXES.

    information (57, 2) is that along the motion and across it; pixels is the number of pixels
    1 / sum(g^2) over whose noise a matched filter sums.
    """

    streak_px: float
    information: np.ndarray
    pixels: float

    def at(self, flux_e: np.ndarray) -> np.ndarray:
        """Return the information (N, 2), along and across, of fluxes (N,)."""
        logarithm = np.log(np.clip(flux_e, _FLUXES[0], _FLUXES[-1]))
        return np.exp(np.stack([np.interp(logarithm, np.log(_FLUXES), np.log(column))
                                for column in self.information.T], -1))


def noise_e2(detector: DetectorOptions) -> float:
    """Return the variance of a pixel without a star, e-^2: background, dark, read, rounding."""
    return (detector.background_e + detector.dark_current_e_s * detector.exposure_s
            + detector.read_noise_e ** 2 + detector.gain_e_per_dn ** 2 / 12)


@lru_cache(maxsize=64)
def star_image(detector: DetectorOptions, streak_px: float) -> StarImage:
    """Return the expected image of a star on the optical axis, mean of positions in a pixel."""
    sigma_px = detector.psf_sigma_px
    reach_px = _REACH_SIGMAS * sigma_px + 1
    along = np.arange(-np.ceil(reach_px + streak_px / 2), np.ceil(reach_px + streak_px / 2) + 1)
    across = np.arange(-np.ceil(reach_px), np.ceil(reach_px) + 1)
    steps = 2 * int(np.ceil(streak_px / sigma_px)) + 1
    node, weight = np.polynomial.legendre.leggauss(steps)
    flux_e = np.minimum(_FLUXES, 1e12)[:, None, None]
    information, pixels = np.zeros((len(_FLUXES), 2)), []
    for dx in _OFFSETS_PX:
        for dy in _OFFSETS_PX:
            x, x_slope = _profile(along, dx + streak_px / 2 * node, sigma_px)
            y, y_slope = _profile(across, np.array([dy]), sigma_px)
            x, x_slope = x @ weight / 2, x_slope @ weight / 2
            share = np.outer(x, y[:, 0])
            pixels.append(1 / np.sum(share ** 2))
            slopes = np.stack([np.outer(x_slope, y[:, 0]), np.outer(x, y_slope[:, 0])])
            for axis, slope in enumerate(slopes):
                information[:, axis] += np.sum(
                    (flux_e * slope) ** 2 / (noise_e2(detector) + flux_e * share), axis=(1, 2))
    return StarImage(streak_px, information / len(_OFFSETS_PX) ** 2, float(np.mean(pixels)))


def _profile(pixel: np.ndarray, centre: np.ndarray, sigma_px: float
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each pixel (P,) in Gaussians at centres (K,), (P, K), and its slope."""
    low, high = ((pixel[:, None] + side - centre) / sigma_px for side in (-0.5, 0.5))
    share = (erf(high / np.sqrt(2)) - erf(low / np.sqrt(2))) / 2
    slope = (np.exp(-low ** 2 / 2) - np.exp(-high ** 2 / 2)) / (sigma_px * np.sqrt(2 * np.pi))
    return share, slope


def limiting_magnitude(detector: DetectorOptions, streak_px: float, threshold_sigma: float
                       ) -> float:
    """
    Return V of the star whose peak after a matched filter is threshold_sigma of its noise.

    F / sqrt(B / sum(g^2)) = threshold_sigma, with the noise of the background alone.
    """
    flux_e = threshold_sigma * np.sqrt(
        noise_e2(detector) * star_image(detector, streak_px).pixels)
    return float(-2.5 * np.log10(flux_e / (detector.zero_flux_e_s * detector.exposure_s)))


def motion_px(camera: Camera, detector: DetectorOptions, rate_rad_s: np.ndarray) -> np.ndarray:
    """Return how far (2,) px the star in the middle of the image moves in an exposure."""
    if not detector.motion_smear:
        return np.zeros(2)
    middle = camera.unproject(np.array([(camera.width - 1) / 2, (camera.height - 1) / 2]))
    moved = middle - np.cross(rate_rad_s * detector.exposure_s, middle)
    return camera.project(moved) - camera.project(middle)


def attitude_bound(camera: Camera, detector: DetectorOptions, uv: np.ndarray,
                   flux_e: np.ndarray, rate_rad_s: np.ndarray) -> np.ndarray:
    """
    Return the least covariance (3, 3) rad^2 about sensor axes from stars at uv (N, 2) px.

    flux_e (N,) in electrons, rate_rad_s (3,) on sensor axes. The streak is that of the middle of
    the image. NaN where the stars do not determine the attitude.
    """
    direction = camera.unproject(uv)
    turned = np.stack([camera.project(direction - _STEP_RAD * np.cross(axis, direction))
                       for axis in np.eye(3)], -1)
    jacobian = (turned - uv[:, :, None]) / _STEP_RAD
    streak_px = motion_px(camera, detector, rate_rad_s)
    length = float(np.linalg.norm(streak_px))
    information = star_image(detector, round(length, 2)).at(flux_e)
    along = streak_px / length if length else np.array([1.0, 0.0])
    total = np.zeros((3, 3))
    for axis, weight in zip((along, np.array([-along[1], along[0]])), information.T):
        gradient = np.einsum('i,nij->nj', axis, jacobian)
        total += np.einsum('n,ni,nj->ij', weight, gradient, gradient)
    if len(uv) < 2 or np.linalg.cond(total) > 1e12:
        return np.full((3, 3), np.nan)
    return np.linalg.inv(total)
