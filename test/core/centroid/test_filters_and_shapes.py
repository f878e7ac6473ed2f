# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Filters, connected spots, shapes, hits and the correlated error against slow ways."""

import cv2
import numpy as np
import pytest
from star_windows import psf_image, windows_of
from startracker_ros.core.centroid.background import measure_background, readable
from startracker_ros.core.centroid.detection import Threshold
from startracker_ros.core.centroid.frame import prepare
from startracker_ros.core.centroid.gaussian_fit import fit_stars, ITERATIONS
from startracker_ros.core.centroid.hits import is_hit, least_share
from startracker_ros.core.centroid.noise import NoiseModel
from startracker_ros.core.centroid.point_stars import drifted, duplicates
from startracker_ros.core.centroid.pointing_error import pointing_error, UNCERTAIN
from startracker_ros.core.centroid.psf_sigma import measure_psf_sigma
from startracker_ros.core.centroid.rejection import Rejections
from startracker_ros.core.centroid.shape import classify_shapes, lone_pixel, MARGIN
from startracker_ros.core.centroid.smoothing import (
    filter_across, filter_down, filtered_at, gaussian_kernel)
from startracker_ros.core.centroid.spots import brightest, CELL_SHARE, CELLS, connected_spots
from startracker_ros.core.centroid.windowed_search import peaks_near

NOISE, BACKGROUND = NoiseModel(0.8), 100.0
SIGMA = Threshold(5.5, 0.0)


@pytest.mark.parametrize('sigma_px', [0.5, 1.0, 2.3, 5.0])
def test_the_filter_is_that_of_opencv(sigma_px):
    rng = np.random.default_rng(1)
    image = rng.integers(0, 4000, (40, 52)).astype(np.uint16)
    kernel = gaussian_kernel(sigma_px)
    line = np.concatenate([kernel.weights[:0:-1], kernel.weights]).astype(float)
    assert line.sum() == pytest.approx(1, abs=1e-6)
    assert kernel.noise_gain == pytest.approx((line ** 2).sum(), rel=1e-6)
    expected = cv2.sepFilter2D(image.astype(float), -1, line, line,
                               borderType=cv2.BORDER_REFLECT_101)
    radius = len(kernel.weights) - 1
    ring = np.empty((2 * radius + 1, image.shape[1]), np.uint16)
    row, filtered = np.empty(image.shape[1] + 2 * radius, np.float32), np.empty(image.shape)
    for v in range(image.shape[0]):
        for near in range(max(v - radius, 0), min(v + radius + 1, image.shape[0])):
            ring[near % len(ring)] = image[near]
        filter_down(ring, kernel.weights, v, image.shape[0], row)
        filter_across(row, kernel.weights, 0, image.shape[1], filtered[v])
    np.testing.assert_allclose(filtered, expected, rtol=1e-5)
    for u, v in ((0, 0), (51, 39), (20, 17), (3, 38)):
        assert filtered_at(readable(image), kernel.weights, u, v) == pytest.approx(
            expected[v, u], rel=1e-5)


@pytest.mark.parametrize('share', [0.1, 0.3, 0.5])
def test_connected_spots_are_those_of_opencv(share):
    mask = np.random.default_rng(2).random((60, 80)) < share
    v, u = np.nonzero(mask)
    spot, count = connected_spots(u, v, mask.shape[1], mask.shape[0])
    expected, label = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    assert count == expected - 1
    # The numbers may differ, the sets may not.
    assert len(set(zip(spot, label[v, u]))) == count


def spots(data, sigma_px=1.0):
    """Return windows of data (K, 15, 15) and the fits of stars of this width in the middle."""
    windows = windows_of(data, BACKGROUND)
    start = np.tile([7.0, 7.0, 5000.0, 0.0, sigma_px], (len(data), 1))
    return windows, fit_stars(windows, start, NOISE, 4, ITERATIONS)


def star(sigma_px=1.0, flux=5000.0):
    return psf_image(np.array([7.2, 6.9, flux, 0.0, sigma_px]), 15)


def test_shapes():
    hit = np.zeros((15, 15))
    hit[7, 7] = 3000
    y, x = np.mgrid[:15, :15] - 7.0
    streak = 400 * np.exp(-(x - y) ** 2 / 4 - (x + y) ** 2 / 100)
    data = np.array([star(), hit, star(3.5), streak]) + np.random.default_rng(3).normal(
        0, 10, (4, 15, 15))
    shape = classify_shapes(*reversed(spots(data)))
    np.testing.assert_array_equal(shape.narrow, [False, True, False, False])
    assert not shape.wide[0] and shape.wide[2]
    np.testing.assert_array_equal(shape.elongated, [False, False, False, True])
    assert [lone_pixel(one) for one in data[:2].astype(np.float32)] == [False, True]


@pytest.mark.parametrize('width', [0.6, 0.66, 1.2, 1.5, 1.7])
def test_narrow_and_wide_by_the_chi_square_of_another_width(width):
    """A star of half the width, or of twice that, fits better by MARGIN or does not."""
    rng = np.random.default_rng(round(100 * width))
    windows, fit = spots(np.array([star(width, 1500.0)] * 20) + rng.normal(0, 10, (20, 15, 15)))
    shape = classify_shapes(fit, windows)
    for i in range(20):
        weight, data = (array[i, :, :15].astype(float).ravel()
                        for array in (fit.weight, fit.own))
        for other, name in ((0.5, 'narrow'), (2.0, 'wide')):
            # Flux and level by slow sums; fit.own is without the level of the fit.
            share = psf_image([*fit.parameters[i, :2], 1.0, 0.0, other], 15).ravel()
            J = np.stack([share, np.ones(len(share))])
            found = np.linalg.solve(J * weight @ J.T, J * weight @ data)
            better = fit.chi2[i] - MARGIN - np.sum(weight * (data - found @ J) ** 2)
            if abs(better) > 0.05:
                assert getattr(shape, name)[i] == (better > 0), (i, name, better)


def test_fits_that_drift_and_fits_of_the_same_star():
    windows, fit = spots(np.array([star()] * 3))
    fit.parameters[1, 0] += 2.0
    fit.parameters[2, 0] = np.nan
    np.testing.assert_array_equal(drifted(fit, windows), [False, True, True])
    fit.parameters[:, :2], fit.parameters[:, 2] = [[7, 7], [7.5, 7], [9, 7]], [5000, 4000, 100]
    same = windows._replace(first=np.array([0, 2, 4, 6]), sources=np.array([1, 2, 0, 2, 0, 1]))
    np.testing.assert_array_equal(duplicates(fit, same), [False, True, False])


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
    hit = is_hit(readable(image), uv, np.full(49, 100.0), np.full(49, 10.0), sigma_px)
    # The first one was hit; stars of half a pixel are as sharp as that.
    np.testing.assert_array_equal(hit, (np.arange(49) == 0) & (sigma_px > 0.5))


def test_no_part_of_an_image_takes_all_places():
    rng = np.random.default_rng(5)
    uv = np.concatenate([rng.uniform(0, 60, (200, 2)), rng.uniform(0, 640, (100, 2))])
    chosen = brightest(uv, (640, 640), 64)
    assert len(chosen) == 64 and (np.diff(chosen) > 0).all()
    in_corner = np.count_nonzero((uv[chosen] < 640 / CELLS).all(axis=1))
    assert in_corner == np.ceil(CELL_SHARE * 64 / CELLS ** 2)
    np.testing.assert_array_equal(brightest(uv[:200], (640, 640), 50), np.arange(50))


def test_a_spot_is_rejected_once():
    rejections = Rejections()
    uv = np.arange(8.0).reshape(4, 2)
    kept = rejections.reject(uv, hot=np.array([1, 0, 0, 0], bool),
                             wide=np.array([1, 1, 0, 0], bool), far=np.zeros(4, bool))
    assert rejections.counts == {'hot': 1, 'wide': 1}
    np.testing.assert_array_equal(np.concatenate(rejections.uv), uv[:2])
    np.testing.assert_array_equal(kept, [False, False, True, True])
    other = Rejections()
    other.add('hot', uv[2:])
    other.add_coded(('', 'hot', 'wide'), np.array([0, 2, 0, 1], np.int8), uv)
    assert other.counts == {'hot': 3, 'wide': 1}
    np.testing.assert_array_equal(np.concatenate(other.uv[-2:]), uv[[3, 1]])
    rejections.include(other)
    assert rejections.counts == {'hot': 4, 'wide': 2} and len(rejections.uv) == 5


def scene(sigma_px, kick=None, side_px=256):
    """
    Return an image of nine stars and their parameters (9, 5).

    After a kick (u, v, share) that share of their flux is beside them, which are in the middle of
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
    return readable(np.round(image).astype(np.uint16)), stars


@pytest.mark.parametrize('sigma_px', [0.6, 1.1, 2.2])
def test_the_width_of_the_stars_and_peaks_near_predictions(sigma_px):
    image, stars = scene(sigma_px)
    frame = prepare(image, sigma_px, SIGMA, 16)
    found, certain = measure_psf_sigma(frame)
    assert certain and found == pytest.approx(sigma_px, rel=0.02)
    peaks, near, hits = peaks_near(image, frame.kernel, frame.mesh, SIGMA,
                                   np.concatenate([stars[:, :2] + 2.0, [[10.0, 10.0]]]),
                                   np.full(10, 4.0), least_share(sigma_px))
    np.testing.assert_array_equal(near, np.arange(10) < 9)
    assert not hits
    # The same peaks as in a search of the whole image.
    whole = {tuple(uv): height for uv, height in zip(frame.search.peaks.uv.tolist(),
                                                     frame.search.peaks.height)}
    for uv, height in zip(peaks.uv.tolist(), peaks.height):
        assert height == pytest.approx(whole[tuple(uv)], rel=1e-4)


@pytest.mark.parametrize('kick', [(6.0, 0.0, 0.2), (-4.0, 5.0, 0.3)])
def test_the_correlated_error_is_that_of_the_flux_beside_the_stars(kick):
    """C = b b^T + UNCERTAIN^2 M, of flux A in one point b = A d / (1 + A), M = b d^T."""
    image, stars = scene(0.7, kick=kick)
    d, share, fitted = np.array(kick[:2]), kick[2], stars.copy()
    fitted[:, 2] *= 1 - share
    mesh = measure_background(image, gaussian_kernel(1.0))
    found = pointing_error(image, mesh, 65535.0, np.pad(fitted, ((0, 0), (0, 2))), False)
    b = share * d
    expected = np.outer(b, b) + UNCERTAIN ** 2 * np.outer(b, d)
    # The pixels below EXCESS_SHARE of the brightest one are left out, a tenth of the flux.
    assert 0.8 < np.trace(found) / np.trace(expected) < 1
    np.testing.assert_allclose(found / np.trace(found), expected / np.trace(expected), atol=0.01)
    still, stars = scene(0.7)
    none = pointing_error(still, mesh, 65535.0, np.pad(stars, ((0, 0), (0, 2))), False)
    assert np.trace(none) < 1e-9


def test_parts_that_are_equally_bright_are_a_correlated_error():
    """Some stars are fitted at the one part, some at the other: on the mean they are not off."""
    image, stars = scene(0.7, kick=(-5.0, 2.0, 0.5))
    fitted = np.pad(stars, ((0, 0), (0, 2)))
    fitted[::2, :2] += (-5.0, 2.0)
    fitted[:, 2] *= 0.5
    mesh = measure_background(image, gaussian_kernel(1.0))
    found = pointing_error(image, mesh, 65535.0, fitted, False)
    assert 0.8 < np.trace(found) / (29 / 4 + UNCERTAIN ** 2 * 29 / 2) < 1


def test_rings_about_the_stars_are_not_a_correlated_error():
    """Those of a defocused lens, or of the aperture: symmetrical about centres between pixels."""
    image, stars = scene(0.7)
    y, x = np.mgrid[:image.shape[0], :image.shape[1]]
    for u, v, flux, *_ in stars:
        r = np.hypot(x - u, y - v)
        image = image + 0.01 * flux * np.exp(-(r - 4.0) ** 2)
    mesh = measure_background(image, gaussian_kernel(1.0))
    found = pointing_error(image, mesh, 65535.0, np.pad(stars, ((0, 0), (0, 2))), False)
    assert not found.any()
