# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Search of a smeared image: the common streak of its stars, and the stars by a matched filter.

1. Spots of the thresholded image have second moments; those of a streak differ by L^2 / 12. The
   streak on which most of the brightest spots agree is that of the stars.
2. Fits of the brightest of them, with width, length and direction free, refine it.
3. The image is filtered with the shape of that streak, which collects all of its flux: peaks of
   the result are stars.
"""

from typing import NamedTuple

import cv2
import numpy as np
from startracker_ros.core.centroid.background import background_at, Mesh, over_image
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.noise import initial_noise_model, NoiseModel
from startracker_ros.core.centroid.point_stars import EDGE_SIGMAS, FAINT, inflation
from startracker_ros.core.centroid.psf import FLUX, SIGMA, U, V
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.streak import fit_streak, Streak
from startracker_ros.core.centroid.streak_fit import (
    ANGLE, fit_streaks, flux_at, LENGTH, photon_gain, Pixels, pixels_at, share_at, StreakFit,
    streaks_at)
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths.sorting import SIGMA_PER_MAD

SMOOTHING_PX = 1.5  # before the threshold
SPOT_SIGMAS = 4.0
LEAST_SPOT_PX = 8
MOST_SPOTS = 60  # the brightest
SHORTEST_STREAK_PX = 1.5
LENGTH_SHARE, LENGTH_PX = 0.3, 2.0  # by which two streaks may differ
LEAST_AGREEING = 4
AGREEING_SHARE = 0.3  # of the flux of all spots
FITTED = 12  # spots, the brightest that agree
FIT_ITERATIONS = 12
MAX_MISFIT = 0.2  # share of the flux that the model does not explain
CHANCE_SIGMAS = 2.0
SIGMA_FLOOR_PX = 0.05
MOST_PEAKS = 1000
NOISE_SAMPLES = 7  # one pixel of so many along each axis


class _Spots(NamedTuple):
    """Bright spots: uv (K, 2), flux (K,), streak (K, 2) px by their moments, in a half plane."""

    uv: np.ndarray
    flux: np.ndarray
    streak_px: np.ndarray


def estimate_streak(image: np.ndarray, mesh: Mesh, pixel_noise_dn: float, full_scale_dn: float,
                    sigma_px: float) -> tuple[Streak, float] | None:
    """
    Return the common streak of the stars of image (H, W) and their width in px.

    None where too few spots agree on one. sigma_px is an initial width.
    """
    level = over_image(mesh.level, image.shape)
    spots = _spots(image, level, pixel_noise_dn)
    agreeing = _agreeing(spots)
    if agreeing is None:
        return None
    uv, streak_px = spots.uv[agreeing][:FITTED], spots.streak_px[agreeing][:FITTED]
    flux = spots.flux[agreeing][:FITTED]
    start = streaks_at(uv, streak_px, sigma_px)
    start[:, FLUX] = flux
    pixels = pixels_at(image, mesh, uv, np.full(len(uv), pixel_noise_dn ** 2), full_scale_dn)
    noise = initial_noise_model(mesh.median_level, pixel_noise_dn ** 2)
    fit = fit_streaks(pixels, start, noise, 7, FIT_ITERATIONS)
    star = fit.parameters
    variance = fit.covariance[:, LENGTH, LENGTH]
    good = ((misfit(fit.chi2, fit.dof, star[:, FLUX], fit.covariance[:, FLUX, FLUX])
             < MAX_MISFIT) & (variance > 0) & (variance < (0.3 * star[:, LENGTH]) ** 2)
            & (star[:, LENGTH] > SHORTEST_STREAK_PX))
    if np.count_nonzero(good) < LEAST_AGREEING - 1:
        return None
    star, variance = star[good], variance[good]
    vector = star[:, LENGTH, None] * np.stack([np.cos(star[:, ANGLE]), np.sin(star[:, ANGLE])], -1)
    vector = _same_half_plane(vector)
    streak = fit_streak(np.ascontiguousarray(star[:, :V + 1]), vector,
                        1 / (variance + SIGMA_FLOOR_PX ** 2), image.shape)
    return streak, float(np.median(star[:, SIGMA]))


def misfit(chi2: np.ndarray, dof: np.ndarray, flux: np.ndarray, variance: np.ndarray
           ) -> np.ndarray:
    """
    Return the share (K,) of the flux, squared over noise, that the model leaves.

    What chi-square has by chance is no part of it: of a faint star that would be most.
    """
    by_chance = dof + CHANCE_SIGMAS * np.sqrt(2.0 * dof)
    return np.maximum(chi2 - by_chance, 0.0) / (flux ** 2 / variance)


def search_streaks(image: np.ndarray, level: np.ndarray, streak: Streak, sigma_px: float,
                   threshold_sigmas: float) -> np.ndarray:
    """
    Return the peaks (K, 2) of image (H, W), above level (H, W), after a filter of the streak.

    The brightest come first.
    """
    kernel = _kernel(streak, sigma_px)
    energy = float((kernel ** 2).sum())
    flux = cv2.filter2D(image.astype(np.float32) - level, -1, kernel / energy,
                        borderType=cv2.BORDER_REFLECT_101)
    sample = flux[::NOISE_SAMPLES, ::NOISE_SAMPLES]
    noise = SIGMA_PER_MAD * float(np.median(np.abs(sample - np.median(sample))))
    top = cv2.dilate(flux, np.ones((3, 3), np.uint8))
    v, u = np.nonzero((flux == top) & (flux > threshold_sigmas * noise))
    order = np.argsort(-flux[v, u], kind='stable')[:MOST_PEAKS]
    uv = np.stack([u, v], -1)[order].astype(float)
    heights = flux[v, u][order].astype(float)
    return uv[_alone(uv, heights, streak.at(uv), sigma_px)]


def _kernel(streak: Streak, sigma_px: float) -> np.ndarray:
    """Return the flux (h, w) float32 of a unit streak in the middle of the image."""
    star = streaks_at(np.zeros((1, 2)), np.array([[streak.u_px, streak.v_px]]), sigma_px)[0]
    reach = 2.5 * sigma_px + 1
    across = int(np.ceil(abs(streak.u_px) / 2 + reach))
    down = int(np.ceil(abs(streak.v_px) / 2 + reach))
    return _shares(star, across, down)


@compiled
def _shares(star: np.ndarray, across: int, down: int) -> np.ndarray:
    kernel = np.empty((2 * down + 1, 2 * across + 1), np.float32)
    for y in range(-down, down + 1):
        for x in range(-across, across + 1):
            kernel[y + down, x + across] = share_at(star, x, y)
    return kernel


@compiled
def _alone(uv: np.ndarray, flux: np.ndarray, streak_px: np.ndarray, sigma_px: float
           ) -> np.ndarray:
    """Return the peaks (K,), brightest first, that are no side lobes of brighter ones."""
    alone = np.ones(len(uv), np.bool_)
    for i in range(len(uv)):
        length = np.hypot(streak_px[i, 0], streak_px[i, 1])
        c, s = streak_px[i, 0] / max(length, 1e-9), streak_px[i, 1] / max(length, 1e-9)
        for j in range(i):
            dx, dy = uv[i, 0] - uv[j, 0], uv[i, 1] - uv[j, 1]
            a, b = abs(dx * c + dy * s), abs(dy * c - dx * s)
            if alone[j] and a < length + 3 * sigma_px and b < 3 * sigma_px + 1:
                lobe = flux[j] * max(1 - a / max(length, 1e-9), 0.1)
                alone[i] = alone[i] and flux[i] > 1.5 * lobe
    return alone


def _spots(image: np.ndarray, level: np.ndarray, pixel_noise_dn: float) -> _Spots:
    """Return the brightest spots of the thresholded image that do not touch its border."""
    height, width = image.shape
    smooth = cv2.GaussianBlur(image.astype(np.float32) - level, (0, 0), SMOOTHING_PX)
    noise = pixel_noise_dn / (2 * np.sqrt(np.pi) * SMOOTHING_PX)
    count, label, stats, _ = cv2.connectedComponentsWithStats(
        (smooth > SPOT_SIGMAS * noise).astype(np.uint8), connectivity=8)
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, bottom = left + stats[:, cv2.CC_STAT_WIDTH], top + stats[:, cv2.CC_STAT_HEIGHT]
    inside = (left > 0) & (top > 0) & (right < width) & (bottom < height)
    inside &= stats[:, cv2.CC_STAT_AREA] >= LEAST_SPOT_PX
    inside[0] = False
    v, u = np.nonzero(label)
    spot = label[v, u]
    weight = smooth[v, u].astype(float)
    m = [np.bincount(spot, weight * power, count)
         for power in (np.ones(len(u)), u, v, u * u, u * v, v * v)]
    with np.errstate(divide='ignore', invalid='ignore'):
        mean_u, mean_v = m[1] / m[0], m[2] / m[0]
        uu, vv = m[3] / m[0] - mean_u ** 2, m[5] / m[0] - mean_v ** 2
        cross = m[4] / m[0] - mean_u * mean_v
    # The eigenvalues of the moments differ by L^2 / 12, along and across.
    difference = np.hypot(uu - vv, 2 * cross)
    angle = np.arctan2(2 * cross, uu - vv) / 2
    streak_px = np.sqrt(12 * np.maximum(difference, 0))[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)], -1)
    chosen = np.flatnonzero(inside)
    chosen = chosen[np.argsort(-m[0][chosen], kind='stable')][:MOST_SPOTS]
    return _Spots(np.stack([mean_u, mean_v], -1)[chosen], m[0][chosen],
                  _same_half_plane(streak_px[chosen]))


def _agreeing(spots: _Spots) -> np.ndarray | None:
    """Return the spots (K,) bool of the brightest group of equal streaks, None if it is small."""
    if len(spots.uv) < LEAST_AGREEING:
        return None
    length = np.hypot(*spots.streak_px.T)
    streak = spots.streak_px[:, None]
    distance = np.minimum(np.linalg.norm(streak - spots.streak_px, axis=-1),
                          np.linalg.norm(streak + spots.streak_px, axis=-1))
    agrees = (distance < np.maximum(LENGTH_PX, LENGTH_SHARE * length)[:, None]) & (
        length > SHORTEST_STREAK_PX)[:, None]
    # By their flux: a long faint streak falls into short pieces, which may be more.
    counted = agrees.sum(axis=1) >= LEAST_AGREEING
    best = agrees[np.where(counted, agrees @ spots.flux, -1.0).argmax()]
    if np.count_nonzero(best) < LEAST_AGREEING or (
            spots.flux[best].sum() < AGREEING_SHARE * spots.flux.sum()):
        return None
    return best


def _same_half_plane(streak_px: np.ndarray) -> np.ndarray:
    """Return streaks (K, 2), those against the direction of most reversed."""
    if not len(streak_px):
        return streak_px
    angle = 2 * np.arctan2(streak_px[:, 1], streak_px[:, 0])
    length = np.hypot(*streak_px.T)
    axis = np.arctan2((length * np.sin(angle)).sum(), (length * np.cos(angle)).sum()) / 2
    along = streak_px @ [np.cos(axis), np.sin(axis)]
    return np.where(along < 0, -1.0, 1.0)[:, None] * streak_px


# --- stars that are streaks: fits of the motion of the exposure, and which are no stars ---

ROUGH_ITERATIONS = 6
ITERATIONS = 8
LEAST_PIXELS = 12  # degrees of freedom of a fit


def measure_streaks(frame: Frame, uv: np.ndarray, streak: Streak, sigma_px: float,
                    threshold_sigmas: float, rejections: Rejections) -> Centroids:
    """Fit streaks of this PSF sigma that are near uv (K, 2) px; return the good ones."""
    keep = rejections.reject(uv, edge=_beyond_edge(frame, uv, streak.at(uv), sigma_px))
    start = streaks_at(uv[keep], streak.at(uv[keep]), sigma_px)
    pixels = _pixels(frame, start[:, [U, V]])
    start[:, FLUX] = flux_at(pixels, start)
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    fit = fit_streaks(pixels, start, noise, 4, ROUGH_ITERATIONS)
    keep = rejections.reject(fit.parameters[:, [U, V]], **_no_stars(fit, start, threshold_sigmas))
    fit = StreakFit(*(column[keep] for column in fit))
    pixels = _pixels(frame, fit.parameters[:, [U, V]])
    noise = NoiseModel(photon_gain(pixels, fit, noise))
    fit = fit_streaks(pixels, fit.parameters, noise, 4, ITERATIONS)
    keep = rejections.reject(
        fit.parameters[:, [U, V]], **_no_stars(fit, start[keep], threshold_sigmas))
    return _centroids(StreakFit(*(column[keep] for column in fit)))


def _pixels(frame: Frame, uv: np.ndarray) -> Pixels:
    """Return the image with the background at uv (K, 2)."""
    noise = np.array([background_at(frame.mesh, round(u), round(v))[1] for u, v in uv.tolist()])
    return pixels_at(frame.image, frame.mesh, uv, (noise / frame.kernel.noise_gain) ** 2,
                     frame.full_scale_dn)


def _beyond_edge(frame: Frame, uv: np.ndarray, streak_px: np.ndarray, sigma_px: float
                 ) -> np.ndarray:
    """Return which streaks (K,) do not end within the image."""
    height, width = frame.image.shape
    margin = np.ceil(EDGE_SIGMAS * sigma_px) + np.abs(streak_px) / 2
    return ((uv < margin) | (uv > [width - 1, height - 1] - margin)).any(axis=1)


def _no_stars(fit: StreakFit, start: np.ndarray, threshold_sigmas: float
              ) -> dict[str, np.ndarray]:
    """Return by reason which fits (K,) are no streaks of stars."""
    star = fit.parameters
    distance = np.hypot(*(star[:, [U, V]] - start[:, [U, V]]).T)
    variance = fit.covariance[:, FLUX, FLUX]
    with np.errstate(invalid='ignore', divide='ignore'):
        significance = star[:, FLUX] / np.sqrt(variance)
        unlike = misfit(fit.chi2, fit.dof, star[:, FLUX], variance) > MAX_MISFIT
    bad = (~np.isfinite(star).all(axis=1) | (fit.dof < LEAST_PIXELS)
           | ~(distance < star[:, LENGTH] / 2 + 3 * star[:, SIGMA]))
    return {'not_fitted': bad | _duplicates(star),
            'faint': ~(significance >= FAINT * threshold_sigmas), 'not_streaked': unlike}


def _duplicates(star: np.ndarray) -> np.ndarray:
    """Return which streaks (K,) lie upon a brighter one."""
    away = star[:, None, [U, V]] - star[:, [U, V]]
    c, s = np.cos(star[:, ANGLE]), np.sin(star[:, ANGLE])
    along = np.abs(away[..., 0] * c + away[..., 1] * s)
    across = np.abs(away[..., 1] * c - away[..., 0] * s)
    close = (along < 0.5 * star[:, LENGTH] + star[:, SIGMA]) & (across < star[:, SIGMA])
    return (close & (star[:, FLUX] > star[:, FLUX, None])).any(axis=1)


def _centroids(fit: StreakFit) -> Centroids:
    """Return fitted streaks."""
    star, factor = fit.parameters, inflation(fit.chi2, fit.dof)
    covariance = fit.covariance[:, :V + 1, :V + 1] * (factor ** 2)[:, None, None]
    return Centroids(
        star[:, [U, V]], star[:, FLUX],
        star[:, FLUX] / np.sqrt(fit.covariance[:, FLUX, FLUX]) / factor,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2), covariance)
