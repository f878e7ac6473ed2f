# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Filters, connected spots, shapes, hits and the correlated error against slow ways."""

import cv2
from native_core import call, filled
import native_fits
import numpy as np
import pytest
from star_windows import field_without_background, moved, psf_image, windows_of
from startracker_ros.core.centroid.extraction import CELL_SHARE, CentroidExtractor

GAIN_DN, BACKGROUND = 0.8, 100.0
MARGIN = 9.0  # of chi-square, by which another width is better
UNCERTAIN = 0.15  # share of the flux
CELLS = 8  # along each side of an image


@pytest.mark.parametrize('sigma_px', [0.5, 1.0, 2.3, 5.0])
def test_the_filter_is_that_of_opencv(sigma_px):
    image = np.random.default_rng(1).integers(0, 4000, (40, 52)).astype(np.uint16)
    radius = int(np.ceil(2 * sigma_px))
    by_rows, by_pixels, gain = np.empty(image.shape), np.empty(image.shape), np.empty(1)
    call('stt_filter', image, 52, 40, sigma_px, by_rows, by_pixels, gain)
    line = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
    line /= line.sum()
    assert gain[0] == pytest.approx((line ** 2).sum(), rel=1e-6)
    expected = cv2.sepFilter2D(image.astype(float), -1, line, line,
                               borderType=cv2.BORDER_REFLECT_101)
    np.testing.assert_allclose(by_rows, expected, rtol=1e-5)
    np.testing.assert_allclose(by_pixels, expected, rtol=1e-5)


@pytest.mark.parametrize('share', [0.1, 0.3, 0.5])
def test_connected_spots_are_those_of_opencv(share):
    mask = np.random.default_rng(2).random((60, 80)) < share
    spot = mask.astype(np.int32)
    count = call('stt_connect', spot, 80, 60)
    expected, label = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    assert count == expected - 1
    # The numbers may differ, the sets may not.
    assert len(set(zip(spot[mask], label[mask]))) == count


def spots(data, sigma_px=1.0):
    """Return the fits of stars of this width in the middle of windows of data (K, 15, 15)."""
    start = np.tile([7.0, 7.0, 5000.0, 0.0, sigma_px], (len(data), 1))
    return windows_of(data, BACKGROUND).fit(moved(start), (GAIN_DN, 0.0), 4, 12)


def star(sigma_px=1.0, flux=5000.0):
    return psf_image(np.array([7.2, 6.9, flux, 0.0, sigma_px]), 15)


def test_narrow_and_wide_shapes():
    hit = np.zeros((15, 15))
    hit[7, 7] = 3000
    data = np.array([star(), hit, star(3.5)]) + np.random.default_rng(3).normal(
        0, 10, (3, 15, 15))
    narrow, wide = spots(data).shape[:, 4:].T
    np.testing.assert_array_equal(narrow, [False, True, False])
    assert not wide[0] and wide[2]


def measured(image, peaks):
    """Return stars and kinds of rejection after fits from peaks (K, 3) u, v, height."""
    field = field_without_background(np.round(image).astype(np.uint16), BACKGROUND, 10.0)
    rows = [[u, v, 0.0, 0.0, height, BACKGROUND, 10.0] for u, v, height in peaks]
    found, _ = native_fits.measure_points(field._replace(peaks=np.array(rows, float)), 1.0)
    return found.stars, sorted(native_fits.KINDS[kind] for kind in found.rejected['kind'])


def stars_of(*stars, side_px=48):
    noise = np.random.default_rng(3).normal(BACKGROUND, 10, (side_px, side_px))
    return noise + sum(psf_image(np.array([*one, 0.0, 1.0]), side_px) for one in stars)


def test_a_fit_that_drifts_from_its_peak_is_of_something_else():
    image = stars_of((24.0, 24.0, 5000.0))
    (star_found,), kinds = measured(image, [(25, 24, 400.0)])
    assert (star_found['u'], star_found['v']) == pytest.approx((24, 24), abs=0.05) and not kinds
    stars, kinds = measured(image, [(26, 24, 400.0)])
    assert len(stars) == 0 and kinds == ['not_fitted']


def test_two_fits_of_the_same_star_are_one():
    one, other = (24.0, 24.0, 5000.0), (26.5, 24.0, 4000.0)
    stars, kinds = measured(stars_of(one), [(24, 24, 500.0), (25, 24, 400.0)])
    assert len(stars) == 1 and kinds == ['not_fitted']
    stars, kinds = measured(stars_of(one, other), [(24, 24, 500.0), (26, 24, 400.0)])
    assert len(stars) == 2 and not kinds
    np.testing.assert_allclose(stars['u'], [one[0], other[0]], atol=0.1)


def test_pieces_of_an_elongated_spot_are_elongated():
    y, x = np.mgrid[:48, :48] - 24.0
    image = stars_of((8.0, 40.0, 5000.0)) + 400 * np.exp(-(x - y) ** 2 / 4 - (x + y) ** 2 / 100)
    stars, kinds = measured(image, [(8, 40, 500.0), (24, 24, 400.0)])
    assert len(stars) == 1 and kinds == ['elongated']
    # A piece at its end is round, its neighbour is not.
    stars, kinds = measured(image, [(8, 40, 500.0), (24, 24, 400.0), (29, 29, 150.0)])
    assert len(stars) == 1 and kinds == ['elongated', 'elongated']


@pytest.mark.parametrize('width', [0.6, 0.66, 1.2, 1.5, 1.7])
def test_narrow_and_wide_by_the_chi_square_of_another_width(width):
    """A star of half the width, or of twice that, fits better by MARGIN or does not."""
    rng = np.random.default_rng(round(100 * width))
    fit = spots(np.array([star(width, 1500.0)] * 20) + rng.normal(0, 10, (20, 15, 15)))
    found, shape = moved(fit.star, -1), dict(zip(('narrow', 'wide'), fit.shape[:, 4:].T))
    for i in range(20):
        weight, data = (array[i].astype(float).ravel()
                        for array in (fit.weight, fit.own))
        for other, name in ((0.5, 'narrow'), (2.0, 'wide')):
            # Flux and level by slow sums; fit.own is without the level of the fit.
            share = psf_image([*found[i, :2], 1.0, 0.0, other], 15).ravel()
            J = np.stack([share, np.ones(len(share))])
            best = np.linalg.solve(J * weight @ J.T, J * weight @ data)
            better = fit.chi2[i] - MARGIN - np.sum(weight * (data - best @ J) ** 2)
            if abs(better) > 0.05:
                assert shape[name][i] == (better > 0), (i, name, better)


@pytest.mark.parametrize('sigma_px', [0.5, 0.8, 1.5])
def test_no_star_is_a_hit_wherever_it_is_within_its_pixel(sigma_px):
    phase = np.linspace(-0.5, 0.5, 7)
    image = np.full((21, 21 * 49), 100.0)
    for i, (u, v) in enumerate(np.stack(np.meshgrid(phase, phase), -1).reshape(-1, 2)):
        image[:, 21 * i:21 * i + 21] += psf_image([10 + u, 10 + v, 20000, 0, sigma_px], 21)
    image[10, 10] += 30000
    image = np.round(image).astype(np.uint16)
    uv = np.array([[21 * i + np.argmax(image[:, 21 * i:21 * i + 21].max(axis=0)),
                    np.argmax(image[:, 21 * i:21 * i + 21].max(axis=1))] for i in range(49)])
    hit = filled('stt_hits', (49,), image, image.shape[1], 21, uv.astype(float), 49, 100.0, 10.0,
                 sigma_px)
    # The first one was hit; stars of half a pixel are as sharp as that.
    np.testing.assert_array_equal(hit, (np.arange(49) == 0) & (sigma_px > 0.5))


def test_no_part_of_an_image_takes_all_places():
    rng = np.random.default_rng(5)
    uv = np.concatenate([rng.uniform(0, 60, (200, 2)), rng.uniform(0, 640, (100, 2))])
    chosen = np.flatnonzero(filled('stt_choose', (300,), uv, 300, 640, 640, 64, CELL_SHARE))
    assert len(chosen) == 64
    in_corner = np.count_nonzero((uv[chosen] < 640 / CELLS).all(axis=1))
    assert in_corner == np.ceil(CELL_SHARE * 64 / CELLS ** 2)
    few = filled('stt_choose', (200,), uv[:200], 200, 640, 640, 50, CELL_SHARE)
    np.testing.assert_array_equal(np.flatnonzero(few), np.arange(50))


def scene(sigma_px, kick=None, side_px=256):
    """
    Return an image of nine stars and their parameters (9, 5).

    After a kick (u, v, share) that share of their flux is next to them, which are in the middle of
    pixels.
    """
    rng = np.random.default_rng(6)
    node = np.arange(48, 240, 80)
    uv = np.stack(np.meshgrid(node, node), -1).reshape(-1, 2) + (
        0.0 if kick else rng.uniform(-0.5, 0.5, (9, 2)))
    stars = np.column_stack([uv, np.geomspace(30000, 8000, 9), np.zeros(9), np.full(9, sigma_px)])
    image = np.full((side_px, side_px), 300.0)
    for one in stars:
        share = kick[2] if kick else 0.0
        image += (1 - share) * psf_image(one, side_px)
        if kick:
            image += share * psf_image(one + [*kick[:2], 0, 0, 0], side_px)
    image += rng.normal(0, np.sqrt(image))
    return np.round(image).astype(np.uint16), stars


def pointing_error(image, stars):
    """Return the covariance (2, 2) px^2 of an error that stars (K, 5) of a scene share."""
    return native_fits.pointing_error(
        field_without_background(image, 300.0), np.pad(stars, ((0, 0), (0, 2))), False)


@pytest.mark.parametrize('sigma_px', [0.6, 1.1, 2.2])
def test_the_width_of_the_stars_and_those_near_predictions(sigma_px):
    image, stars = scene(sigma_px)
    extractor = CentroidExtractor()
    whole, searched = extractor.search(image)
    assert whole.psf_sigma_px == pytest.approx(sigma_px, rel=0.02)
    near, _ = extractor.search_near(
        image, np.concatenate([stars[:, :2] + 2.0, [[10.0, 10.0]]]), np.full(10, 4.0), searched)
    assert len(near.centroids) == 9 and near.rejected == {'faint': 1}
    np.testing.assert_allclose(near.centroids.uv, whole.centroids.uv, atol=0.02)
    uv, width_px = extractor.measure_widths(image, searched, 9)
    assert len(uv) == 9
    np.testing.assert_allclose(width_px, sigma_px, rtol=0.05)


@pytest.mark.parametrize('kick', [(6.0, 0.0, 0.2), (-4.0, 5.0, 0.3)])
def test_the_correlated_error_is_that_of_the_flux_beside_the_stars(kick):
    """C = b b^T + UNCERTAIN^2 M, of flux A in one point b = A d / (1 + A), M = b d^T."""
    image, stars = scene(0.7, kick=kick)
    d, share, fitted = np.array(kick[:2]), kick[2], stars.copy()
    fitted[:, 2] *= 1 - share
    found = pointing_error(image, fitted)
    b = share * d
    expected = np.outer(b, b) + UNCERTAIN ** 2 * np.outer(b, d)
    # The pixels below EXCESS_SHARE of the brightest one are left out, a tenth of the flux.
    assert 0.8 < np.trace(found) / np.trace(expected) < 1
    np.testing.assert_allclose(found / np.trace(found), expected / np.trace(expected), atol=0.01)
    still, stars = scene(0.7)
    none = pointing_error(still, stars)
    assert np.trace(none) < 1e-9


def test_parts_that_are_equally_bright_are_a_correlated_error():
    """Some stars are fitted at the one part, some at the other: on the mean they are not off."""
    image, stars = scene(0.7, kick=(-5.0, 2.0, 0.5))
    fitted = stars.copy()
    fitted[::2, :2] += (-5.0, 2.0)
    fitted[:, 2] *= 0.5
    found = pointing_error(image, fitted)
    assert 0.8 < np.trace(found) / (29 / 4 + UNCERTAIN ** 2 * 29 / 2) < 1


def test_rings_about_the_stars_are_not_a_correlated_error():
    """Those of a defocused lens, or of the aperture: symmetrical about centres between pixels."""
    image, stars = scene(0.7)
    y, x = np.mgrid[:image.shape[0], :image.shape[1]]
    for u, v, flux, *_ in stars:
        r = np.hypot(x - u, y - v)
        image = image + 0.01 * flux * np.exp(-(r - 4.0) ** 2)
    image = image.astype(np.uint16)
    found = pointing_error(image, stars)
    assert not found.any()
