# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What the Python fits give for the images of native_fits.py: the record for test_native_fits.py.

python test/record_native_fits.py writes test/native/fits.npz. It goes with the Python fits.
"""

import native_fits
from native_fits import METHODS, RECORD, SEGMENTATION
import numpy as np
from startracker_ros.core.centroid import shape
from startracker_ros.core.centroid.background import over_image, readable
from startracker_ros.core.centroid.detection import Threshold
from startracker_ros.core.centroid.frame import prepare
from startracker_ros.core.centroid.gaussian_fit import fit_stars
from startracker_ros.core.centroid.moments import Segmentation
from startracker_ros.core.centroid.noise import initial_noise_model
from startracker_ros.core.centroid.point_stars import measure_points, refine_noise_model
from startracker_ros.core.centroid.pointing_error import pointing_error
from startracker_ros.core.centroid.psf_sigma import measure_psf_sigma
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.streak import Streak
from startracker_ros.core.centroid.streak_fit import (
    fit_streaks, flux_at, photon_gain, Pixels, streaks_at)
from startracker_ros.core.centroid.streak_search import (
    _pixels, estimate_streak, measure_streaks, search_streaks)
from startracker_ros.core.centroid.windows import cut_windows, initial_stars


def _listed(name, centroids, rejections):
    uv = np.concatenate(rejections.uv) if rejections.uv else np.empty((0, 2))
    counts = [rejections.counts.get(kind, 0) for kind in native_fits.KINDS]
    cov = centroids.covariance.reshape(-1, 4)[:, [0, 1, 3]]
    return {f'{name} stars': np.column_stack([
        centroids.uv, centroids.flux, centroids.snr, centroids.sigma_px, cov]),
        f'{name} rejected': uv, f'{name} kinds': np.array(counts)}


def _field(frame):
    mesh, peaks = frame.mesh, frame.search.peaks
    return {'level': mesh.level, 'noise': mesh.noise,
            'numbers': np.array([mesh.median_level, mesh.median_noise, *mesh.scale,
                                 frame.kernel.sigma_px, frame.full_scale_dn]),
            'peaks': np.column_stack([peaks.uv, peaks.top, peaks.height, peaks.level,
                                      peaks.noise]).astype(float).reshape(-1, 7)}


def _fits(frame, sigma_px):
    """Yield the fits of all peaks with what follows from them: names and arrays."""
    peaks, chosen = frame.search.peaks, np.arange(len(frame.search.peaks.uv))
    windows = cut_windows(
        frame.image, frame.mesh, frame.kernel, frame.full_scale_dn, peaks, chosen, sigma_px)
    start = initial_stars(frame.kernel, peaks, chosen, sigma_px)
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    yield 'gain', np.array([noise.gain_dn])
    yield 'windows', np.concatenate([
        windows.data.sum(axis=(1, 2), dtype=float), windows.used.sum(axis=(1, 2)),
        windows.variance])
    for free, iterations in native_fits.FITS:
        fit, name = fit_stars(windows, start, noise, free, iterations), f'fit {free} {iterations}'
        yield f'{name} star', fit.parameters
        yield f'{name} covariance', fit.covariance
        yield f'{name} chi2', np.stack([fit.chi2, fit.dof], -1)
        moments, narrow_wide = shape._moments(fit, windows), shape._test_sigmas(fit, windows)
        yield f'{name} shape', np.column_stack([moments, *narrow_wide])
        if free == 4 and len(chosen):
            yield f'{name} noise', np.array(refine_noise_model(
                noise, fit, windows, np.ones(len(chosen), bool)))


def _points(frame, sigma_px):
    for method in METHODS:
        rejections = Rejections()
        centroids, smeared = measure_points(
            frame, frame.search.peaks, sigma_px, 5.5, method,
            Segmentation(*SEGMENTATION[method]), rejections, 1000)
        yield from _listed(method, centroids, rejections).items()
        yield f'{method} smeared', np.array(smeared)


def _streaks(frame, sigma_px, known):
    found = estimate_streak(frame.image, frame.mesh, frame.noise_dn, frame.full_scale_dn, 1.0)
    yield 'estimate', np.array([*found[0], found[1]] if found else [])
    if known is None:
        return
    streak = Streak(*known)
    level = over_image(frame.mesh.level, frame.image.shape)
    places = search_streaks(frame.image, level, streak, sigma_px, 5.5)
    yield 'places', places
    rejections = Rejections()
    centroids = measure_streaks(frame, places, streak, sigma_px, 5.5, rejections)
    yield from _listed('streaks', centroids, rejections).items()
    start = streaks_at(places, streak.at(places), sigma_px)
    pixels: Pixels = _pixels(frame, places)
    start[:, 2] = flux_at(pixels, start)
    yield 'sky', np.column_stack([pixels.background, pixels.variance])
    yield 'start', start
    noise = initial_noise_model(frame.background_dn, frame.noise_dn ** 2)
    for free in (4, 7):
        fit, name = fit_streaks(pixels, start, noise, free, 8), f'streaks {free}'
        yield f'{name} star', fit.parameters
        yield f'{name} covariance', fit.covariance
        yield f'{name} chi2', np.stack([fit.chi2, fit.dof], -1)
        if free == 4:
            yield 'streaks gain', np.array([photon_gain(pixels, fit, noise)])
    yield 'pointing of streaks', pointing_error(
        frame.image, frame.mesh, frame.full_scale_dn, fit.parameters, True)


def record():
    """Return all arrays, by case and name."""
    arrays = {}
    for case, (image, bits, known) in native_fits.cases().items():
        frame = prepare(readable(image), 1.0, Threshold(5.5, 0.0), bits)
        found = dict(_field(frame))
        sigma_px, certain = measure_psf_sigma(frame)
        found['sigma'] = np.array([sigma_px, certain, *measure_psf_sigma(frame, True)])
        found.update(_fits(frame, sigma_px))
        found.update(_points(frame, sigma_px))
        found.update(_streaks(frame, 1.0, known))
        stars = np.zeros((min(len(found['gaussian stars']), 40), 7))
        stars[:, :3], stars[:, 4] = found['gaussian stars'][:40, :3], sigma_px
        found['pointed'] = stars
        found['pointing'] = pointing_error(
            frame.image, frame.mesh, frame.full_scale_dn, stars, False)
        found['digest'] = native_fits.digest_of(image)
        arrays.update({f'{case}/{name}': value for name, value in found.items()})
    return arrays


if __name__ == '__main__':
    np.savez_compressed(RECORD, **record())
