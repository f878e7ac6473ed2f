# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stars that are points: fits of a Gaussian to peaks, and which of them are no stars."""

import math

import numpy as np
from startracker_ros.core.centroid.background import Mesh
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.detection import Peaks
from startracker_ros.core.centroid.frame import Frame
from startracker_ros.core.centroid.gaussian_fit import Fit, fit_stars, ITERATIONS
from startracker_ros.core.centroid.moments import Segmentation, weighted_means, WEIGHTS
from startracker_ros.core.centroid.noise import initial_noise_model, NoiseModel
from startracker_ros.core.centroid.psf import D_CENTRE, FLUX, LEVEL, profile, SHARE, SIGMA, U, V
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.shape import classify_shapes, lone_pixel, streaks
from startracker_ros.core.centroid.smoothing import Kernel
from startracker_ros.core.centroid.windows import (
    cut_windows, initial_stars, saturated_core, Windows)
from startracker_ros.core.compiled import compiled, fused, reordered
from startracker_ros.core.maths.sorting import ascending_order

ROUGH_ITERATIONS = 2
EDGE_SIGMAS = 1.5  # closest distance of a star to the edge of the image, in PSF sigmas
MAX_SATURATED_PX = 24  # of the 5 x 5 pixels around the peak: its flanks show where a star is,
FEW_SATURATED_PX = 4  # but each pixel more than these may have bloomed
BLOOMING_PX = 0.02
FAINT = 0.85  # of the threshold: the fit frees position and level too, so its SNR is lower
MISFIT = 3.0  # standard deviations of chi-square beyond which errors are inflated
REASONS = ('', 'edge', 'saturated', 'hot_pixel', 'cosmic_ray', 'elongated', 'too_wide',
           'not_fitted', 'faint')
STAR, EDGE, SATURATED, HOT_PIXEL, COSMIC_RAY, ELONGATED, TOO_WIDE, NOT_FITTED, FAINT_SPOT = range(
    len(REASONS))
GAUSSIAN = -1  # method, beside those of the weighted means

MAX_DRIFT_PX = 1.5  # a fit that ends further from its peak is of something else
SEPARATION_PX = 1.0  # two closer fits are of one star


def measure_points(frame: Frame, peaks: Peaks, sigma_px: float, threshold_sigmas: float,
                   method: str, segmentation: Segmentation, rejections: Rejections, most: int
                   ) -> tuple[Centroids, bool]:
    """
    Fit stars of this PSF sigma to the peaks.

    Return good ones, at most so many, brightest first, and whether all are smeared.
    """
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    kind = GAUSSIAN if method == 'gaussian' else WEIGHTS.index(method)
    reason, where, uv, flux, snr, error_px, smeared = _measure(
        frame.image, frame.mesh, frame.kernel, frame.full_scale_dn, peaks, noise, sigma_px,
        FAINT * threshold_sigmas, kind, segmentation, most)
    rejections.add_coded(REASONS, reason, where)
    return Centroids(uv, flux, snr, error_px), smeared


@compiled
def _measure(image: np.ndarray, mesh: Mesh, kernel: Kernel, full_scale: float, peaks: Peaks,
             noise: NoiseModel, sigma_px: float, least_significance: float, kind: int,
             segmentation: Segmentation, most: int
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray,
                        bool]:
    """
    Return what the K peaks of image (H, W) are, and the N brightest stars, at most so many.

    These are reason (K,), STAR or why a peak is none, and where (K, 2) px; uv (N, 2) px, flux
    (N,) DN, its ratio to its error and the error (N,) px of the position; and whether all spots
    are smeared. A rough fit rejects what is no star and measures the noise of the final one.
    """
    reason, where = np.zeros(len(peaks.uv), np.int8), peaks.uv.astype(np.float64)
    chosen = np.arange(len(reason))
    windows = cut_windows(image, mesh, kernel, full_scale, peaks, chosen, sigma_px)
    _reject_cut(image, windows, math.ceil(EDGE_SIGMAS * sigma_px), peaks, reason)
    stars = _not_rejected(chosen, reason)
    if len(stars) < len(chosen):
        chosen = stars
        windows = cut_windows(image, mesh, kernel, full_scale, peaks, chosen, sigma_px)
    start = initial_stars(kernel, peaks, chosen, sigma_px)
    fit = fit_stars(windows, start, noise, 4, ROUGH_ITERATIONS)
    smeared = _reject_shapes(fit, windows, chosen, reason, where)
    noise = refine_noise_model(noise, fit, windows, _unsaturated(windows, chosen, reason))
    stars = _not_rejected(chosen, reason)
    start = fit.parameters
    if len(stars) < len(chosen):
        start = _rows_of(stars, chosen, start)
        chosen = stars
        windows = cut_windows(image, mesh, kernel, full_scale, peaks, chosen, sigma_px)
    fit = fit_stars(windows, start, noise, 4, ITERATIONS)
    uv, error_px = _positions(fit, windows)
    if kind != GAUSSIAN:
        uv, error_px = weighted_means(kind, windows, fit, noise, segmentation)
    _reject_final(fit, windows, uv, least_significance, chosen, reason, where)
    return (reason, where, *_brightest(fit, uv, error_px, chosen, reason, most), smeared)


@compiled
def _not_rejected(chosen: np.ndarray, reason: np.ndarray) -> np.ndarray:
    """Return those of the chosen spots (K,) that are stars by their reason."""
    left, count = np.empty(len(chosen), np.int64), 0
    for spot in chosen:
        if reason[spot] == STAR:
            left[count] = spot
            count += 1
    return left[:count]


@compiled
def _rows_of(stars: np.ndarray, chosen: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Return the parameters (N, 5) of stars (N,) out of those of the chosen spots (K,)."""
    rows, i = np.empty((len(stars), parameters.shape[1])), 0
    for n in range(len(stars)):
        while chosen[i] != stars[n]:
            i += 1
        rows[n] = parameters[i]
    return rows


@compiled
def _reject_cut(image: np.ndarray, windows: Windows, border_px: int, peaks: Peaks,
                reason: np.ndarray) -> None:
    """Set the reason (K,) of peaks closer than border_px to the edge, or saturated."""
    height, width = image.shape
    for i in range(len(reason)):
        u, v = peaks.uv[i, 0], peaks.uv[i, 1]
        if min(u, v, width - 1 - u, height - 1 - v) < border_px:
            reason[i] = EDGE
        elif saturated_core(windows, i) > MAX_SATURATED_PX:
            reason[i] = SATURATED


@compiled
def _reject_shapes(fit: Fit, windows: Windows, chosen: np.ndarray, reason: np.ndarray,
                   where: np.ndarray) -> bool:
    """
    Set the reason (K,) and the position where (K, 2) px of chosen spots that have no star's shape.

    Return whether all are smeared.
    """
    shape, astray = classify_shapes(fit, windows), drifted(fit, windows)
    for i in range(len(chosen)):
        where[chosen[i]] = fit.parameters[i, :V + 1]
        if shape.narrow[i]:
            reason[chosen[i]] = HOT_PIXEL if lone_pixel(windows.data[i]) else COSMIC_RAY
        elif shape.elongated[i]:
            reason[chosen[i]] = ELONGATED
        elif shape.wide[i]:
            reason[chosen[i]] = TOO_WIDE
        elif astray[i]:
            reason[chosen[i]] = NOT_FITTED
    return shape.smeared


@compiled
def _unsaturated(windows: Windows, chosen: np.ndarray, reason: np.ndarray) -> np.ndarray:
    """Return which chosen spots (K,) are stars by their reason, without a saturated pixel."""
    good = np.empty(len(chosen), np.bool_)
    for i in range(len(chosen)):
        good[i] = reason[chosen[i]] == STAR and saturated_core(windows, i) == 0
    return good


@compiled
def _reject_final(fit: Fit, windows: Windows, uv: np.ndarray, least_significance: float,
                  chosen: np.ndarray, reason: np.ndarray, where: np.ndarray) -> None:
    """Set the reason of chosen spots (K,) whose last fit, or position uv (K, 2), is of no star."""
    astray, doubled = drifted(fit, windows), duplicates(fit, windows)
    for i in range(len(chosen)):
        where[chosen[i]] = fit.parameters[i, :V + 1]
        if astray[i] or doubled[i]:
            reason[chosen[i]] = NOT_FITTED
        elif _significance(fit, i) < least_significance or not np.isfinite(uv[i, 0]):
            reason[chosen[i]] = FAINT_SPOT


@compiled
def _brightest(fit: Fit, uv: np.ndarray, error_px: np.ndarray, chosen: np.ndarray,
               reason: np.ndarray, most: int
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return uv (N, 2), flux, its ratio to its error and error_px (N,) of the brightest stars."""
    place, flux = np.empty((len(chosen), 2)), np.empty(len(chosen))
    snr, sigma_px, count = np.empty(len(chosen)), np.empty(len(chosen)), 0
    factor = inflation(fit.chi2, fit.dof)
    # Peaks are highest first: this is nearly sorted.
    for i in ascending_order(-fit.parameters[:, FLUX]):
        if reason[chosen[i]] == STAR and count < most:
            place[count], flux[count] = uv[i], fit.parameters[i, FLUX]
            snr[count], sigma_px[count] = _significance(fit, i) / factor[i], error_px[i]
            count += 1
    return place[:count], flux[:count], snr[:count], sigma_px[:count]


@compiled
def _significance(fit: Fit, i: int) -> float:
    """Return flux over its 1-sigma error by the noise model alone."""
    return fit.parameters[i, FLUX] / math.sqrt(fit.covariance[i, FLUX, FLUX])


@compiled
def _positions(fit: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Return uv (K, 2) px of the fits and their 1-sigma errors (K,) px per axis."""
    uv, error_px = np.empty((len(fit.dof), 2)), inflation(fit.chi2, fit.dof)
    for i in range(len(error_px)):
        uv[i] = fit.parameters[i, :V + 1]
        variance = (fit.covariance[i, U, U] + fit.covariance[i, V, V]) / 2
        blooming_px = BLOOMING_PX * max(saturated_core(windows, i) - FEW_SATURATED_PX, 0)
        error_px[i] = math.hypot(error_px[i] * math.sqrt(variance), blooming_px)
    return uv, error_px


@compiled
def inflation(chi2: np.ndarray, dof: np.ndarray) -> np.ndarray:
    """Return factors (K,) of the errors: sqrt(chi2 / dof) for a misfit beyond chance, else 1."""
    factor = np.ones(len(chi2))
    for i in range(len(chi2)):
        ratio = chi2[i] / dof[i]
        if ratio > 1 + MISFIT * math.sqrt(2 / dof[i]):
            factor[i] = math.sqrt(ratio)
    return factor


@compiled
def fit_free_sigma(image: np.ndarray, mesh: Mesh, kernel: Kernel, full_scale: float,
                   peaks: Peaks, noise: NoiseModel, sigma_px: float, iterations: int
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Fit stars of another PSF sigma each, from sigma_px on, to peaks that are not saturated.

    Return parameters (K, 5), covariance (K, 5, 5), chi-square (K,) and degrees of freedom (K,) of
    those with more than a lone pixel, and which (K,) have the shape and the place of their spot.
    """
    chosen, reason = np.arange(len(peaks.uv)), np.zeros(len(peaks.uv), np.int8)
    windows = cut_windows(image, mesh, kernel, full_scale, peaks, chosen, sigma_px)
    for i in range(len(chosen)):
        if saturated_core(windows, i) > 0 or lone_pixel(windows.data[i]):
            reason[i] = SATURATED
    chosen = _not_rejected(chosen, reason)
    windows = cut_windows(image, mesh, kernel, full_scale, peaks, chosen, sigma_px)
    fit = fit_stars(windows, initial_stars(kernel, peaks, chosen, sigma_px), noise, SIGMA + 1,
                    iterations)
    return (fit.parameters, fit.covariance, fit.chi2, fit.dof,
            ~drifted(fit, windows) & ~streaks(fit, windows))


@compiled
def drifted(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for fits that ended far from their peaks or are NaN."""
    radius, far = windows.data.shape[1] // 2, np.empty(len(fit.parameters), np.bool_)
    for i in range(len(far)):
        far[i] = not (math.hypot(fit.parameters[i, U] - windows.corner[i, 0] - radius,
                                 fit.parameters[i, V] - windows.corner[i, 1] - radius)
                      < MAX_DRIFT_PX)
    return far


@compiled
def duplicates(fit: Fit, windows: Windows) -> np.ndarray:
    """Return True (K,) for the fainter of two fits closer than SEPARATION_PX."""
    duplicate = np.zeros(len(fit.parameters), np.bool_)
    for i in range(len(duplicate)):
        for k in range(windows.first[i], windows.first[i + 1]):
            star, other = fit.parameters[i], fit.parameters[windows.sources[k]]
            if math.hypot(star[U] - other[U], star[V] - other[V]) < SEPARATION_PX:
                duplicate[i] |= star[FLUX] < other[FLUX]
    return duplicate


# --- gain and model error of the noise, out of the residuals of all stars ---

PRIOR_PIXELS = 10.0  # weight of the initial gain
NOISE_ITERATIONS = 3
OUTLIER = 16.0  # variances, to which a squared residual is limited
MIN_FREE = 0.1  # share of a pixel's noise that its residual shows at least


@reordered
def refine_noise_model(noise: NoiseModel, fit: Fit, windows: Windows,
                       chosen: np.ndarray) -> NoiseModel:
    """
    Fit gain and model error to the residuals of chosen stars (K,), by iterated least squares.

    The squares of the residuals r, divided by 1 - h for the leverage h of their pixel, have the
    mean background + gain flux + (model_error flux)^2. The initial gain counts as
    PRIOR_PIXELS pixels, so that one or two faint stars change nothing.
    """
    square, flux, background = _pixels(fit, windows, chosen)
    gain, model_error, prior = noise.gain_dn, noise.model_error, noise.gain_dn
    for _ in range(NOISE_ITERATIONS):
        # Normal equations [a b; b c] [gain, model_error^2] = [p q].
        a, b, c = PRIOR_PIXELS / prior ** 2, 0.0, 0.0
        p, q = PRIOR_PIXELS / prior, 0.0
        for k in range(len(square)):
            variance = background[k] + flux[k] * (gain + model_error ** 2 * flux[k])
            excess = min(square[k], OUTLIER * variance) - background[k]
            d_gain = flux[k] / variance
            d_error, excess = flux[k] * d_gain, excess / variance
            a, b, c = a + d_gain * d_gain, b + d_gain * d_error, c + d_error * d_error
            p, q = p + d_gain * excess, q + d_error * excess
        gain, model_error = _solve(a, b, c, p, q)
    return NoiseModel(gain, model_error)


@reordered
def _pixels(fit: Fit, windows: Windows, chosen: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return r^2 / (1 - h), flux and background variance of the used pixels of chosen stars."""
    _, count, filled = windows.data.shape
    columns, rows = np.empty((3, filled), np.float32), np.empty((3, count), np.float32)
    h, pixels = np.empty((count, filled), np.float32), 0
    size = np.count_nonzero(chosen) * count * filled
    square, flux = np.empty(size, np.float32), np.empty(size, np.float32)
    background = np.empty(size, np.float32)
    for i in range(len(chosen)):
        if chosen[i]:
            _leverage(fit, windows, i, columns, rows, h)
            for y in range(count):
                for x in range(filled):
                    if windows.used[i, y, x]:
                        square[pixels] = ((fit.own[i, y, x] - fit.model[i, y, x]) ** 2
                                          / max(1 - h[y, x], np.float32(MIN_FREE)))
                        flux[pixels] = fit.model[i, y, x]
                        background[pixels] = windows.variance[i]
                        pixels += 1
    return square[:pixels], flux[:pixels], background[:pixels]


@fused
def _leverage(fit: Fit, windows: Windows, i: int, columns: np.ndarray, rows: np.ndarray,
              h: np.ndarray) -> None:
    """
    Fill h (n, m) = w J C J^T: the share of each pixel's noise that the fit of star i absorbs.

    J = (F d a_u, F d_v a, d a, 1) and C the covariance, as in normal_equations.py. columns
    (3, m) and rows (3, n) are work arrays.
    """
    star, c = fit.parameters[i], fit.covariance[i]
    profile(star[U], star[SIGMA], windows.corner[i, 0], columns)
    profile(star[V], star[SIGMA], windows.corner[i, 1], rows)
    for y in range(h.shape[0]):
        # J C J^T is a quadratic form in a_u, a and 1, with coefficients of the row.
        d = float(rows[SHARE, y])
        fd, fdv = star[FLUX] * rows[SHARE, y], star[FLUX] * rows[D_CENTRE, y]
        c_uu = np.float32(fd * fd * c[U, U])
        c_ua = np.float32(2 * fd * (fdv * c[U, V] + d * c[U, FLUX]))
        c_aa = np.float32(fdv * fdv * c[V, V] + 2 * fdv * d * c[V, FLUX] + d * d * c[FLUX, FLUX])
        c_u1, c_11 = np.float32(2 * fd * c[U, LEVEL]), np.float32(c[LEVEL, LEVEL])
        c_a1 = np.float32(2 * (fdv * c[V, LEVEL] + d * c[FLUX, LEVEL]))
        for x in range(h.shape[1]):
            a, a_u = columns[SHARE, x], columns[D_CENTRE, x]
            total = a_u * (c_uu * a_u + c_ua * a + c_u1) + a * (c_aa * a + c_a1) + c_11
            h[y, x] = total * fit.weight[i, y, x]


@fused
def _solve(a: float, b: float, c: float, p: float, q: float) -> tuple[float, float]:
    """Return x and sqrt(y) that solve [a b; b c] [x y] = [p q] best with x, y >= 0."""
    determinant = a * c - b * b
    if determinant > 0:
        x, y = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        if x >= 0 and y >= 0:
            return x, np.sqrt(y)
    x, y = max(p, 0.0) / a, max(q, 0.0) / c if c > 0 else 0.0
    return (x, 0.0) if a * x ** 2 >= c * y ** 2 else (0.0, np.sqrt(y))
