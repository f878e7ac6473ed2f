# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The fits of the native core give what those in Python gave: fits.npz.

Discrete results are equal. Fits of points sum in float32, so that they agree to some 1e-6 of
themselves or of their errors, and those of streaks, which sum in float64, to 1e-9.
"""

from functools import cache

import native_fits
from native_fits import (
    cases, Field, field_of, FITS, KINDS, METHODS, RECORD, SEGMENTATION, Windows)
import numpy as np
import pytest

FLOAT32, FLOAT64 = 2e-6, 1e-9
OF_SIGMA = 3e-5  # of fits in float32: their difference over their errors
NAMES = [*native_fits.SKIES, *native_fits.PHOTOGRAPHS]
STREAKED = [name for name, sky in native_fits.SKIES.items() if any(sky.streak)]


@cache
def record_of(name: str) -> tuple[Field, dict[str, np.ndarray]]:
    """Return what the fits see of an image, and what they gave."""
    with np.load(RECORD) as archive:
        record = {key.partition('/')[2]: archive[key] for key in archive.files
                  if key.startswith(f'{name}/')}
    image = images()[name][0]
    assert np.array_equal(native_fits.digest_of(image), record['digest']), 'another image'
    return field_of(image, record), record


@cache
def images():
    return cases()


def close(found, expected, relative, scale=0.0):
    """Compare arrays, to a share of the expected one or of a scale."""
    assert np.shape(found) == np.shape(expected)
    limit = relative * np.maximum(np.abs(expected), scale)
    equal = (found == expected) | (np.isnan(found) & np.isnan(expected))
    assert (equal | (np.abs(found - expected) <= limit)).all(), np.max(
        np.abs(found - expected) / np.maximum(limit, 1e-300) * ~equal)


def sigmas_of(covariance):
    return np.sqrt(np.abs(np.einsum('kii->ki', covariance)))


def same_lists(measured, record, name, relative, of_sigma):
    stars, expected = measured.stars, record[f'{name} stars']
    found = np.stack([stars[column] for column in (
        'u', 'v', 'flux', 'snr', 'sigma', 'uu', 'uv', 'vv')], -1)
    assert len(found) == len(expected)
    counts = np.bincount(measured.rejected['kind'], minlength=len(KINDS))
    assert counts.tolist() == record[f'{name} kinds'].tolist()
    sigma_px = expected[:, 4:5]
    assert (np.abs(found[:, :2] - expected[:, :2]) <= of_sigma * sigma_px).all()
    close(found[:, 2:5], expected[:, 2:5], relative)
    close(found[:, 5:], expected[:, 5:], 2 * relative, sigma_px ** 2)
    where = np.stack([measured.rejected['u'], measured.rejected['v']], -1)
    assert np.abs(where - record[f'{name} rejected']).max(initial=0.0) < 1e-5


@pytest.mark.parametrize('name', NAMES)
def test_the_psf_sigma_is_that_of_the_record(name):
    field, record = record_of(name)
    for narrow, (sigma_px, certain) in enumerate(record['sigma'].reshape(2, 2)):
        found = native_fits.psf_sigma(field, bool(narrow))
        assert found == (pytest.approx(sigma_px, rel=FLOAT32), bool(certain))


@pytest.mark.parametrize('name', NAMES)
def test_windows_fits_and_shapes_are_those_of_the_record(name):
    field, record = record_of(name)
    windows = native_fits.cut_windows(field, record['sigma'][0])
    found = np.concatenate([windows.data.sum(axis=(1, 2), dtype=float),
                            windows.used.sum(axis=(1, 2)), windows.variance])
    close(found, record['windows'], FLOAT64, 1.0)
    start = windows.star.copy()
    for free, iterations in FITS:
        fit, of = windows.fit(start, (record['gain'][0], 0.0), free, iterations), (
            f'fit {free} {iterations}')
        expected, covariance = record[f'{of} star'], record[f'{of} covariance']
        # A fit that does not converge within its iterations multiplies what is rounded.
        whole = well_fitted(record, of, record['sigma'][0])
        sigma = sigmas_of(covariance)[whole]
        assert (np.abs(fit.star[whole, :free] - expected[whole, :free])
                <= OF_SIGMA * sigma).all()
        close(fit.covariance[whole], covariance[whole], 5 * FLOAT32,
              sigma[:, :, None] * sigma[:, None])
        close(fit.chi2[whole], record[f'{of} chi2'][whole, 0], 5 * FLOAT32)
        assert (fit.dof == record[f'{of} chi2'][:, 1]).all()
        shape, moments = fit.shape[whole], record[f'{of} shape'][whole]
        assert (shape[:, 4:] == moments[:, 4:]).all()
        close(shape[:, :4], moments[:, :4], 5 * FLOAT32,
              np.abs(moments[:, 2:3]) + np.sqrt(np.abs(moments[:, 3:4])))
        if free == 4 and len(start) and whole.all():
            close(fit.noise, record[f'{of} noise'], 10 * FLOAT32, record['gain'][0] * 1e-3)


def well_fitted(record, name, sigma_px):
    """Return which fits (K,) of a record ended near their peaks, if sigma is free as stars."""
    star, peaks, (chi2, dof) = record[f'{name} star'], record['peaks'], record[f'{name} chi2'].T
    near = np.hypot(*(star[:, :2] - peaks[:, :2]).T) < 1.5
    if name.startswith('fit 4'):
        return near
    return near & (np.abs(np.log(star[:, 4] / sigma_px)) < 0.5) & (chi2 < 2 * dof)


@pytest.mark.parametrize('name', NAMES)
def test_stars_and_rejected_spots_are_those_of_the_record(name):
    field, record = record_of(name)
    for method in METHODS:
        measured, smeared = native_fits.measure_points(
            field, record['sigma'][0], method, SEGMENTATION[method])
        same_lists(measured, record, method, 5 * FLOAT32, OF_SIGMA)
        assert smeared == record[f'{method} smeared']


def test_no_more_stars_are_listed_than_are_wanted():
    field, record = record_of('points')
    measured, _ = native_fits.measure_points(field, record['sigma'][0], most=7)
    flux = record['gaussian stars'][:, 2]
    close(measured.stars['flux'], np.sort(flux)[::-1][:7], 5 * FLOAT32)


@pytest.mark.parametrize('name', STREAKED)
def test_streaks_are_fitted_as_in_the_record(name):
    field, record = record_of(name)
    sky, start, gain_dn = record['sky'], record['start'], record['gain'][0]
    close(native_fits.streak_flux(field, sky, start), start[:, 2], FLOAT64)
    for free in (4, 7):
        star, covariance, chi2, dof = native_fits.fit_streaks(
            field, sky, start, gain_dn, free, 8)
        expected, expected_covariance = (
            record[f'streaks {free} {what}'] for what in ('star', 'covariance'))
        expected_chi2 = record[f'streaks {free} chi2']
        # One that does not converge within its iterations multiplies what is rounded.
        sigma = sigmas_of(expected_covariance)
        whole = (np.hypot(*(expected[:, :2] - start[:, :2]).T) < 1.5) & (
            expected_chi2[:, 0] < 2 * expected_chi2[:, 1])
        assert np.count_nonzero(whole) >= 3
        assert (np.abs(star[:, :free] - expected[:, :free])[whole]
                <= 1e-7 * sigma[whole]).all()
        close(covariance[whole], expected_covariance[whole], 1e-6,
              (sigma[:, :, None] * sigma[:, None])[whole])
        close(chi2[whole], expected_chi2[whole, 0], FLOAT64)
        assert (dof == expected_chi2[:, 1])[whole].all()
    found = native_fits.photon_gain(field, sky, record['streaks 4 star'], gain_dn)
    assert found == pytest.approx(record['streaks gain'][0], rel=FLOAT64)


@pytest.mark.parametrize('name', STREAKED)
def test_streaks_are_found_and_judged_as_in_the_record(name):
    field, record = record_of(name)
    _, _, streak = images()[name]
    places = native_fits.search_streaks(field, streak, 1.0)
    assert places.tolist() == record['places'].tolist()
    same_lists(native_fits.measure_streaks(field, places, streak, 1.0), record, 'streaks',
               FLOAT64, 1e-7)


@pytest.mark.parametrize('name', NAMES)
def test_an_image_shows_the_streak_of_the_record_or_none(name):
    field, record = record_of(name)
    found = native_fits.estimate_streak(field)
    assert len(found) == len(record['estimate'])
    # It starts with moments of an image that is smoothed in float32.
    close(found, record['estimate'], FLOAT32, 1.0)


@pytest.mark.parametrize('name', NAMES)
def test_the_error_that_all_stars_share_is_that_of_the_record(name):
    field, record = record_of(name)
    found = native_fits.pointing_error(field, record['pointed'], False)
    close(found, record['pointing'], FLOAT64)
    if name in STREAKED:
        found = native_fits.pointing_error(field, record['streaks 7 star'], True)
        close(found, record['pointing of streaks'], FLOAT64)


def test_some_images_have_such_an_error():
    assert all(record_of(name)[1]['pointing'].any() for name in ('kicks', 'tails'))
    assert not record_of('points')[1]['pointing'].any()


# --- equations ---


def test_the_common_streak_is_a_least_squares_fit():
    rng = np.random.default_rng(5)
    uv, weight = rng.uniform(0, 500, (9, 2)), rng.uniform(0.5, 2, 9)
    true = np.array([7.0, -3.0, 0.01, 319.5, 239.5])
    moved = np.stack([true[0] - true[2] * (uv[:, 1] - true[4]),
                      true[1] + true[2] * (uv[:, 0] - true[3])], -1)
    close(native_fits.fit_streak(uv, moved, weight, (480, 640)), true, 1e-10)
    noisy = moved + rng.normal(0, 0.1, moved.shape)
    down, across = uv[:, 1] - true[4], uv[:, 0] - true[3]
    rows = np.concatenate([np.stack([np.ones(9), np.zeros(9), -down], -1),
                           np.stack([np.zeros(9), np.ones(9), across], -1)])
    root = np.sqrt(np.concatenate([weight, weight]))
    expected = np.linalg.lstsq(rows * root[:, None], noisy.T.ravel() * root, rcond=None)[0]
    close(native_fits.fit_streak(uv, noisy, weight, (480, 640))[:3], expected, 1e-9)
    # Too few show no roll.
    assert native_fits.fit_streak(
        uv[:3].copy(), noisy[:3].copy(), weight[:3].copy(), (480, 640))[2] == 0


def test_joined_streaks_have_the_second_moments_of_both():
    one, other = (6.0, 2.0, 0.01, 9.5, 9.5), (-1.0, 3.0, 0.03, 9.5, 9.5)
    joined = native_fits.joined(one, other)
    moments = np.outer(one[:2], one[:2]) + np.outer(other[:2], other[:2])
    least, most = np.linalg.eigvalsh(moments)
    assert np.hypot(*joined[:2]) == pytest.approx(np.sqrt(most - least), rel=1e-12)
    excess = moments - np.outer(joined[:2], joined[:2])
    close(excess, least * np.eye(2), 1e-9, most)
    assert joined[:2] @ one[:2] > 0 and joined[2] == one[2]


@pytest.mark.parametrize('free', [4, 5])
def test_a_window_without_a_usable_pixel_has_no_result_and_harms_none(free):
    windows = Windows(3, 9)
    windows.corner[:, 0] = 0, 100, 200
    windows.variance[:], windows.used[0], windows.used[2] = 9.0, 1.0, 1.0
    windows.data[2] = np.nan
    y, x = np.mgrid[:9, :9]
    windows.data[0] = 2000 * np.exp(-((x - 4.3) ** 2 + (y - 3.8) ** 2) / 2)
    start = np.array([[4.0 + 100 * k, 4.0, 9000.0, 0.0, 1.0] for k in range(3)])
    fit = windows.fit(start, (1.0, 0.0), free, 12)
    assert fit.star[0, :2] == pytest.approx([4.3, 3.8], abs=0.01)
    assert fit.dof.tolist() == [81 - free, -free, 81 - free]
    assert not np.isfinite(fit.star[2, :2]).any()
