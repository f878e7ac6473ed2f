# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors of the fits against the Cramer-Rao bound, over SNR, width and place within a pixel.

No unbiased fit is better, and one that is better by chance is so within the chi-square bounds of
its trials. A fit that is worse by more than LOSS, biased, or wrong about its own error fails.
"""

from itertools import product

from native_fits import fit_streaks
import numpy as np
import pytest
from scipy.stats import chi2
from star_windows import field_without_background, moved, psf_image, windows_of

SNRS, WIDTHS_PX = (10.0, 30.0, 100.0, 400.0), (0.5, 0.8, 1.5, 2.5)
PHASES_PX = ((0.0, 0.0), (0.5, 0.0), (0.25, 0.4), (0.5, 0.5))
GAIN_DN, BACKGROUND, ITERATIONS = 0.8, 150.0, 12
STARS, LOSS = 1500, 1.03
CHANCE = 1e-3 / (2 * len(SNRS) * len(WIDTHS_PX) * len(PHASES_PX))


def flux_of(snr, shape):
    """Return the flux of which an ideal filter of a shape of unit flux has this SNR."""
    def snr_of(flux):
        return np.sqrt(np.sum((flux * shape) ** 2 / (BACKGROUND + GAIN_DN * flux * shape)))
    low, high = 1.0, 1e7
    for _ in range(80):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if snr_of(middle) < snr else (low, middle)
    return low


def bound(model, parameters):
    """Return the Cramer-Rao bound (p, p) of an image; the variance of pixels is known."""
    step = np.array([1e-4, 1e-4, 1e-2, 1e-2])
    rows = [(model(parameters + change) - model(parameters - change)).ravel() / (2 * size)
            for size, change in zip(step, np.diag(step))]
    light = model(parameters) - parameters[3]
    J = np.array(rows)
    return np.linalg.inv(J / (BACKGROUND + GAIN_DN * light).ravel() @ J.T)


def check(errors, variance, stated, snr):
    """
    Check errors (K,) by the bound `variance` and the variance (K,) that the fit states.

    This follows the flux that was found, so that the mean of it is off by some 1 / snr^2.
    """
    count = len(errors)
    low, high = chi2.ppf([CHANCE, 1 - CHANCE], count) / count
    ratio = np.mean(errors ** 2) / variance
    assert low < ratio < high * LOSS, ratio
    assert abs(errors.mean()) < 4.5 * np.sqrt(variance / count)
    assert np.mean(stated) / variance == pytest.approx(1, abs=0.02 + 3 / snr ** 2)


@pytest.mark.parametrize('snr, width_px', [
    pytest.param(snr, width_px, marks=[pytest.mark.long] * (
        (SNRS.index(snr) + WIDTHS_PX.index(width_px)) % 2))
    for snr, width_px in product(SNRS, WIDTHS_PX)])
def test_stars(snr, width_px):
    rng = np.random.default_rng(round(snr + 1000 * width_px))
    side_px = 2 * int(np.ceil(4 * width_px)) + 5
    for phase in PHASES_PX:
        centre = side_px // 2 + np.array(phase)
        star = np.array([*centre, 1.0, 0.0, width_px])
        star[2] = flux_of(snr, psf_image(star, side_px))
        light = psf_image(star, side_px)
        data = light + rng.normal(0, 1, (STARS, *light.shape)) * np.sqrt(
            BACKGROUND + GAIN_DN * light)
        start = np.tile(star, (STARS, 1))
        start[:, :2] += rng.uniform(-0.3, 0.3, (STARS, 2))
        fit = windows_of(data, BACKGROUND).fit(moved(start), (GAIN_DN, 0.0), 4, ITERATIONS)
        found = moved(fit.star, -1)
        variance = bound(lambda one: psf_image([*one, width_px], side_px), star[:4])
        for axis in range(2):
            check(found[:, axis] - star[axis], variance[axis, axis],
                  fit.covariance[:, axis, axis], snr)


def streaked_image(star, streak_px, side_px, steps=60):
    """Return a star (u, v, flux, level, sigma) that moves along a streak, over its pixels."""
    shares = (np.arange(steps) + 0.5) / steps - 0.5
    return np.mean([psf_image(np.array([*(star[:2] + share * np.array(streak_px)), *star[2:]]),
                              side_px) for share in shares], axis=0)


@pytest.mark.parametrize('snr, streak_px', [
    (30.0, (6.0, 0.0)), (100.0, (12.0, -5.0)), *(pytest.param(*case, marks=pytest.mark.long)
                                                 for case in (
        (30.0, (5.0, 5.0)), (30.0, (12.0, -5.0)), (100.0, (6.0, 0.0)), (100.0, (5.0, 5.0))))])
def test_streaks(snr, streak_px):
    """Pixels are integrated over here, as in a camera; the model of the fit is not."""
    rng, side_px, stars = np.random.default_rng(round(snr + 10 * sum(streak_px))), 33, 400
    for phase in PHASES_PX:
        star = np.array([*(side_px // 2 + np.array(phase)), 1.0, 0.0, 1.0])
        star[2] = flux_of(snr, streaked_image(star, streak_px, side_px))
        light = streaked_image(star, streak_px, side_px)
        # One below the other: none reaches the next.
        image = 1000 + np.tile(light, (stars, 1))
        image += rng.normal(0, 1, image.shape) * np.sqrt(
            BACKGROUND + GAIN_DN * (image - 1000))
        start = np.zeros((stars, 7))
        start[:, :5], start[:, 1] = star, star[1] + side_px * np.arange(stars)
        true = start[:, :2].copy()
        start[:, :2] += rng.uniform(-0.3, 0.3, (stars, 2))
        start[:, 5:] = np.hypot(*streak_px), np.arctan2(streak_px[1], streak_px[0])
        field = field_without_background(np.round(image).astype(np.uint16))
        sky = np.tile([1000.0, 0, 0, BACKGROUND], (stars, 1))
        found, covariance, *_ = fit_streaks(field, sky, start, GAIN_DN, 4, ITERATIONS)
        variance = bound(lambda one: streaked_image([*one, 1.0], streak_px, side_px), star[:4])
        along = np.array(streak_px) / np.hypot(*streak_px)
        for axis in (along, along[::-1] * [-1, 1]):
            check((found[:, :2] - true) @ axis, axis @ variance[:2, :2] @ axis,
                  covariance[:, :2, :2] @ axis @ axis, snr)
