# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The equations of the fits against numerical derivatives, integrals and slow sums."""

from native_core import call
from native_fits import fit_streaks, profile
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from star_windows import field_without_background, moved, psf_image, windows_of

LEVEL = 3
GAIN_DN, MODEL_ERROR, BACKGROUND = 0.7, 0.02, 40.0
STEPS = np.array([1e-4, 1e-4, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4])


def derivatives(model, parameters):
    """Return d model / d parameters (P, N) by central differences."""
    rows = []
    for p, step in enumerate(STEPS[:len(parameters)]):
        change = np.zeros(len(parameters))
        change[p] = step
        rows.append((model(parameters + change) - model(parameters - change)).ravel()
                    / (2 * step))
    return np.array(rows)


def gauss_newton(model, parameters, data, free, used=None, model_error=MODEL_ERROR):
    """Return information (free, free), step (free,) and chi-square of a fit with slow sums."""
    expected = model(parameters)
    flux = expected - parameters[LEVEL]
    weight = 1 / (BACKGROUND + GAIN_DN * flux + (model_error * flux) ** 2).ravel()
    if used is not None:
        weight = weight * used.ravel()
    J = derivatives(model, parameters)[:free]
    residual = (data - expected).ravel()
    information = J * weight @ J.T
    return (information, np.linalg.solve(information, J * weight @ residual),
            np.sum(weight * residual ** 2))


def same_information(found, expected):
    """Compare matrices (p, p), each element in units of its diagonal."""
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=2e-4)


@pytest.mark.parametrize('centre', [10.0, 10.31, 9.5])
@pytest.mark.parametrize('sigma', [0.35, 0.8, 2.5])
def test_the_profile_is_the_normal_distribution_over_pixels(centre, sigma):
    share = profile(centre, sigma, 0, 21)

    def expected(u, s):
        return np.diff(norm.cdf(np.arange(-0.5, 21), u, s))
    step = 1e-5
    np.testing.assert_allclose(share[0], expected(centre, sigma), atol=2e-7)
    np.testing.assert_allclose(
        share[1], (expected(centre + step, sigma) - expected(centre - step, sigma))
        / (2 * step), atol=2e-6)
    np.testing.assert_allclose(
        share[2], (expected(centre, sigma + step) - expected(centre, sigma - step))
        / (2 * step), atol=2e-6)


@pytest.mark.parametrize('free_sigma', [False, True])
@pytest.mark.parametrize('u, v, sigma', [(7.0, 7.0, 0.6), (7.4, 6.7, 1.1), (6.5, 7.5, 2.0)])
def test_information_step_and_chi_square_of_a_star(u, v, sigma, free_sigma):
    start = np.array([u, v, 5000.0, 3.0, sigma])
    rng = np.random.default_rng(1)
    data = psf_image(start + [0.1, -0.05, 300.0, 1.0, 0.05], 15) + rng.normal(0, 5, (15, 15))
    windows = windows_of(data[None], BACKGROUND)
    windows.used[0, 3, 8] = 0.0
    free = 5 if free_sigma else 4
    information, step, chi2 = gauss_newton(
        lambda star: psf_image(star, 15), start, windows.data[0].astype(float), free,
        windows.used[0])
    noise = GAIN_DN, MODEL_ERROR
    fit = windows.fit(start[None], noise, free, 0)
    same_information(np.linalg.inv(fit.covariance[0]), information)
    assert fit.chi2[0] == pytest.approx(chi2, rel=1e-4)
    assert fit.dof[0] == 15 * 15 - 1 - free
    windows.fit(start[None], noise, free, 1)
    np.testing.assert_allclose(
        (windows.star[0] - start)[:free], step, rtol=2e-3,
        atol=1e-3 * np.sqrt(np.diag(np.linalg.inv(information))).min())


def streak_flux(star, x, y):
    """Return the flux of a Gaussian that moves along a line, integrated over the exposure."""
    u, v, flux, _, sigma, length, angle = star
    variance = sigma ** 2 + 1 / 12

    def at(t):
        square = ((x - u - t * length * np.cos(angle)) ** 2
                  + (y - v - t * length * np.sin(angle)) ** 2)
        return np.exp(-square / (2 * variance)) / (2 * np.pi * variance)
    return flux * quad(at, -0.5, 0.5, epsabs=1e-13, epsrel=1e-11)[0]


@pytest.mark.parametrize('length, angle', [(0.5, 0.0), (6.0, 0.7), (15.0, -1.2)])
def test_the_flux_of_a_streak_is_that_of_a_moving_star(length, angle):
    star = np.array([10.2, 9.7, 1.0, 0.0, 0.9, length, angle])
    for x, y in ((10, 10), (12, 9), (7, 13), (10, 4)):
        share = call('stt_streak_share', star, float(x), float(y))
        assert share == pytest.approx(streak_flux(star, x, y), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize('free', [4, 7])
@pytest.mark.parametrize('length, angle', [(5.0, 0.0), (8.0, 0.6), (12.0, -1.0)])
def test_information_step_and_chi_square_of_a_streak(length, angle, free):
    start = np.array([20.3, 19.6, 9000.0, 2.0, 1.1, length, angle])
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:41, :41]
    dx, dy = x - start[0], y - start[1]
    along = dx * np.cos(angle) + dy * np.sin(angle)
    across = dy * np.cos(angle) - dx * np.sin(angle)
    reach = 3.5 * np.sqrt(1.1 ** 2 + 1 / 12) + 1
    fitted = ((np.abs(across) <= reach) & (np.abs(along) <= length / 2 + reach)
              & (np.abs(dx) <= length / 2 * abs(np.cos(angle)) + reach)
              & (np.abs(dy) <= length / 2 * abs(np.sin(angle)) + reach))

    def model(star):
        return np.array([streak_flux(star, *pixel) + star[LEVEL]
                         for pixel in zip(x[fitted], y[fitted])])
    # A background that rises by 0.5 DN a pixel along u.
    level = 500 + 0.5 * x
    image = level.copy()
    image[fitted] += (model(start + [0.2, -0.1, 300.0, 1.0, 0.0, 0.3, 0.01])
                      + rng.normal(0, 6, fitted.sum()))
    field = field_without_background(np.round(image).astype(np.uint16))
    sky = np.array([[500.0, 0.5, 0.0, BACKGROUND]])
    data = (np.round(image) - level)[fitted]
    information, step, chi2 = gauss_newton(model, start, data, free, model_error=0.0)
    _, covariance, chi2_found, dof = fit_streaks(field, sky, start[None], GAIN_DN, free, 0)
    same_information(np.linalg.inv(covariance[0]), information)
    assert chi2_found[0] == pytest.approx(chi2, rel=1e-6)
    assert dof[0] == fitted.sum() - free
    after = fit_streaks(field, sky, start[None], GAIN_DN, free, 1)[0]
    np.testing.assert_allclose((after[0] - start)[:free], step, rtol=1e-4)


@pytest.mark.parametrize('gain, model_error', [(0.3, 0.0), (2.0, 0.0), (0.5, 0.05)])
def test_the_noise_model_is_that_of_the_pixels(gain, model_error):
    """The initial model is wrong by a factor of 3; 300 stars of many fluxes show the right one."""
    rng, count = np.random.default_rng(4), 300
    star = np.column_stack([*rng.uniform(6.5, 7.5, (2, count)), np.geomspace(500, 50000, count),
                            np.zeros(count), np.full(count, 1.0)])
    light = np.array([psf_image(one, 15) for one in star])
    sigma = np.sqrt(BACKGROUND + gain * light + (model_error * light) ** 2)
    windows = windows_of(light + sigma * rng.normal(0, 1, light.shape), BACKGROUND)
    noise = 3 * gain, 0.0
    for _ in range(4):
        noise = tuple(windows.fit(moved(star), noise, 4, 12).noise)
    # Both at once: with the model error free, that of small fluxes is in its error.
    assert noise[0] == pytest.approx(gain, rel=0.06)
    assert noise[1] == pytest.approx(model_error, rel=0.06, abs=0.012)
