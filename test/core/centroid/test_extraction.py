# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Centroid extraction against known truth, on ugly images, and on real photographs."""

import csv

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import erf
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.core.maths.rotation import conjugate, rotate
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

SKY_E, READ_E, GAIN_E_PER_DN, OFFSET_DN = 200.0, 10.0, 1.5, 100.0
# Enough for the crowded fields here; the default keeps to what a star tracker follows.
TILE_PX = 64
EXTRACT = CentroidExtractor(ExtractionOptions(max_stars=150)).measure


def light(shape, uv, flux, sigma_px, reach=14):
    """Stars of a Gaussian point spread function integrated over the pixels."""
    image = np.zeros(shape)
    for (u, v), total in zip(uv, np.broadcast_to(flux, len(uv))):
        first = np.maximum(np.array([u, v]).astype(int) - reach, 0)
        last = np.minimum(np.array([u, v]).astype(int) + reach, np.array(shape[::-1]) - 1)
        across, down = (np.diff(erf((np.arange(a, b + 2) - 0.5 - centre) / sigma_px / 2 ** 0.5))
                        for a, b, centre in zip(first, last, (u, v)))
        image[first[1]:last[1] + 1, first[0]:last[0] + 1] += total * np.outer(down, across) / 4
    return image


def expose(electrons, rng, dtype=np.uint16, gain=GAIN_E_PER_DN, offset=OFFSET_DN, top=None):
    top = np.iinfo(dtype).max if top is None else top
    signal = rng.poisson(electrons) + rng.normal(0, READ_E, electrons.shape)
    return np.clip(np.round(signal / gain + offset), 0, top).astype(dtype)


def scattered(rng, count, size):
    """Return positions on a grid, each moved at random by up to 3 px per axis."""
    side = int(np.ceil(count ** 0.5))
    node = (np.arange(side) + 0.5) * size / side
    uv = np.stack(np.meshgrid(node, node), -1).reshape(-1, 2)[:count]
    return uv + rng.uniform(-3, 3, uv.shape)


def flux_of_snr(snr, sigma_px=0.8, noise_e2=SKY_E + READ_E ** 2):
    """Electrons of a star with this SNR under an ideal matched filter."""
    pixels = 1 / (light((31, 31), [(15.25, 15.25)], 1, sigma_px) ** 2).sum()
    return (snr ** 2 + np.sqrt(snr ** 4 + 4 * snr ** 2 * noise_e2 * pixels)) / 2


def cramer_rao_px(flux, sigma_px=0.8):
    """Bound of the error per axis: flux and level free, width known."""
    def pixels(u):
        return light((31, 31), [(u, 15.3)], flux, sigma_px)
    slopes = np.stack([(pixels(15.31) - pixels(15.29)) / 0.02, pixels(15.3) / flux,
                       np.ones((31, 31))]).reshape(3, -1)
    noise = (pixels(15.3) + SKY_E + READ_E ** 2).ravel()
    return np.linalg.inv(slopes / noise @ slopes.T)[0, 0] ** 0.5


def found(extraction, uv, within_px=1.5):
    """Return index into centroids of each true star (-1 missed) and the number of false ones."""
    if not len(extraction.centroids):
        return np.full(len(uv), -1), 0
    distance, index = cKDTree(extraction.centroids.uv).query(uv)
    index = np.where(distance < within_px, index, -1)
    return index, len(extraction.centroids) - len(set(index[index >= 0]))


def gradient_sky(size):
    return SKY_E * (1 + 0.1 * np.linspace(-0.5, 0.5, size)) * np.ones((size, 1))


@pytest.mark.parametrize('sigma_px', [0.5, 0.8, 1.2, 2.5])
def test_without_noise_the_error_is_below_a_thousandth_of_a_pixel(sigma_px):
    uv = scattered(np.random.default_rng(1), 36, 512)
    image = np.round(light((512, 512), uv, 60000.0, sigma_px) + 100).astype(np.uint16)
    result = EXTRACT(image)
    index, false = found(result, uv)
    assert (index >= 0).all() and false == 0
    assert np.abs(result.centroids.uv[index] - uv).max() < 1e-3
    np.testing.assert_allclose(result.centroids.flux, 60000, rtol=1e-3)
    assert result.psf_sigma_px == pytest.approx(sigma_px, rel=1e-3)


@pytest.mark.parametrize('snr', [7, 10, 20, 50, 100, 300])
def test_errors_match_sigma_and_are_near_the_cramer_rao_bound(snr):
    rng = np.random.default_rng(snr)
    flux, errors, sigmas = flux_of_snr(snr), [], []
    for _ in range(4):
        uv = scattered(rng, 81, 1024)
        result = EXTRACT(expose(gradient_sky(1024) + light((1024, 1024), uv, flux, 0.8), rng))
        index, _ = found(result, uv)
        seen = index >= 0
        assert seen.mean() >= (0.85 if snr < 10 else 0.98)
        errors.append(result.centroids.uv[index[seen]] - uv[seen])
        sigmas.append(result.centroids.sigma_px[index[seen]])
    errors, sigmas = np.concatenate(errors), np.concatenate(sigmas)
    low, high = mean_chi_square_bounds(1, errors.size)
    assert low < (errors ** 2 / sigmas[:, None] ** 2).mean() < high
    assert np.sqrt((errors ** 2).mean()) < 1.08 * cramer_rao_px(flux)
    assert np.abs(errors.mean(0)).max() < 4 * sigmas.mean() / len(errors) ** 0.5


@pytest.mark.parametrize('method', ['binary', 'grey', 'squared', 'thresholded', 'gaussian'])
def test_sigma_of_every_method_is_that_of_the_errors(method):
    rng = np.random.default_rng(12)
    extract = CentroidExtractor(ExtractionOptions(method=method, max_stars=300)).measure
    chi2 = []
    for snr in (10, 20, 50, 100, 300):
        uv = scattered(rng, 256, 1024)
        sky = gradient_sky(1024) + light((1024, 1024), uv, flux_of_snr(snr), 0.8)
        result = extract(expose(sky, rng))
        index, _ = found(result, uv)
        seen = index >= 0
        assert seen.mean() > 0.98
        error = (result.centroids.uv[index] - uv)[seen]
        chi2.append((error ** 2 / result.centroids.sigma_px[index[seen], None] ** 2).ravel())
        assert chi2[-1].mean() == pytest.approx(1, abs=0.2)
    chi2 = np.concatenate(chi2)
    low, high = mean_chi_square_bounds(1, len(chi2))
    # sigma is that of all places within a pixel, up to a tenth larger than that of these.
    assert low / 1.1 < chi2.mean() < high, (low, chi2.mean(), high)


def test_a_fixed_threshold_is_in_dn():
    rng = np.random.default_rng(13)
    uv = scattered(rng, 36, 512)
    image = expose(SKY_E + light((512, 512), uv, np.geomspace(1500, 50000, 36), 0.8), rng)
    counts = [len(CentroidExtractor(ExtractionOptions(
        threshold='fixed', threshold_dn=threshold_dn)).measure(image).centroids)
        for threshold_dn in (100.0, 1000.0, 60000.0)]
    assert 36 >= counts[0] > counts[1] > counts[2] == 0


@pytest.mark.parametrize('change', [
    lambda image: np.pad(image, ((0, 0), (0, 8)))[:, :-8],
    lambda image: np.frombuffer(image.tobytes(), image.dtype).reshape(image.shape),
    np.asfortranarray])
def test_layout_in_memory_does_not_matter(change):
    rng = np.random.default_rng(14)
    uv = scattered(rng, 16, 300)
    image = expose(SKY_E + light((300, 300), uv, 20000.0, 0.8), rng)
    np.testing.assert_array_equal(EXTRACT(change(image)).centroids.uv, EXTRACT(image).centroids.uv)


def test_stars_of_all_magnitudes_in_one_image():
    rng = np.random.default_rng(2)
    chi2, lost, false = [], 0, 0
    for _ in range(12):
        uv, snr = scattered(rng, 36, 512), np.geomspace(10, 300, 36)
        flux = np.array([flux_of_snr(s) for s in snr])
        result = EXTRACT(expose(gradient_sky(512) + light((512, 512), uv, flux, 0.8), rng))
        index, extra = found(result, uv)
        seen = index >= 0
        lost, false = lost + (~seen).sum(), false + extra
        chosen = result.centroids
        chi2.append((chosen.uv[index[seen]] - uv[seen]) ** 2
                    / chosen.sigma_px[index[seen], None] ** 2)
        assert (np.diff(chosen.flux) <= 0).all()
        strong = seen & (snr > 100)
        np.testing.assert_allclose(chosen.flux[index[strong]] * GAIN_E_PER_DN, flux[strong],
                                   rtol=0.06)
        np.testing.assert_allclose(chosen.snr[index[strong]], snr[strong], rtol=0.35)
    assert lost <= 2 and false <= 1
    chi2 = np.concatenate(chi2)
    low, high = mean_chi_square_bounds(1, chi2.size)
    assert low < chi2.mean() < high, (low, chi2.mean(), high)


def test_detection_at_default_threshold():
    rng = np.random.default_rng(3)
    seen = false = 0
    for _ in range(8):
        uv = scattered(rng, 100, 1024)
        image = expose(gradient_sky(1024) + light((1024, 1024), uv, flux_of_snr(10), 0.8), rng)
        index, extra = found(EXTRACT(image), uv)
        seen, false = seen + (index >= 0).sum(), false + extra
    assert seen >= 0.99 * 800
    assert false <= 2


@pytest.mark.parametrize('gain', [20.0, 60.0, 200.0])
def test_coarsely_quantised_8_bit_images(gain):
    """At 200 electrons per DN the sky noise is a tenth of a DN: most pixels are equal."""
    rng = np.random.default_rng(4)
    uv = scattered(rng, 36, 1024)
    flux = flux_of_snr(20, noise_e2=SKY_E + READ_E ** 2 + gain ** 2 / 12)
    result = EXTRACT(expose(SKY_E + light((1024, 1024), uv, flux, 0.8), rng, np.uint8, gain, 3.0))
    index, false = found(result, uv)
    assert (index >= 0).all() and false == 0
    error = (result.centroids.uv[index] - uv) / result.centroids.sigma_px[index, None]
    low, high = mean_chi_square_bounds(1, error.size)
    assert low < (error ** 2).mean() < high, (low, (error ** 2).mean(), high)


def test_steep_gradient_gives_no_false_stars():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:768, :1024]
    sky = 200 + 8000 * np.exp(-((x - 520) ** 2 + (y - 380) ** 2) / 2 / 300 ** 2)
    uv = scattered(rng, 49, 760)
    result = EXTRACT(expose(sky + light(sky.shape, uv, 20000.0, 0.8), rng))
    index, false = found(result, uv)
    assert (index >= 0).all() and false == 0


def test_hot_pixels_cosmic_hits_and_streaks_are_rejected():
    rng = np.random.default_rng(6)
    uv = scattered(rng, 25, 512)
    clean = SKY_E + light((512, 512), uv, np.geomspace(2000, 40000, 25), 0.8)
    hot = clean.copy()
    for strength in np.geomspace(400, 30000, 20):
        u, v = rng.integers(20, 490, 2)
        hot[v, u] += strength
        u, v = rng.integers(20, 490, 2)
        hot[v, u:u + 2] += strength
    result = EXTRACT(expose(hot, rng))
    index, false = found(result, uv)
    assert (index >= 0).sum() >= 24 and false <= 1
    assert result.rejected['hot_pixel'] + result.rejected['cosmic_ray'] >= 35
    assert min(result.rejected['hot_pixel'], result.rejected['cosmic_ray']) >= 15

    for length in (8, 60):
        at = np.linspace(-0.5, 0.5, 80)[:, None] * length * np.array([0.8, 0.6])
        streak = light(clean.shape, at + [275.3, 190.1], 1500.0 * length / 80, 0.8)
        result = EXTRACT(expose(clean + streak, rng))
        index, false = found(result, uv)
        assert (index >= 0).sum() >= 22 and false == 0
        assert result.rejected.get('elongated', 0) + result.rejected.get('line', 0) >= 1


def ring(radius_px, across, down):
    """Return the share of light of pixels across, down from a star defocused to a ring."""
    distance = np.hypot(across, down)
    edge = erf((radius_px - distance) / 0.7) - erf((radius_px / 2 - distance) / 0.7)
    return edge / (2 * np.pi * radius_px ** 2 * (1 - 1 / 4))


@pytest.mark.parametrize('radius_px', [3.0, 5.0])
def test_stars_that_a_defocused_lens_draws_as_rings_are_one_spot_each(radius_px):
    rng = np.random.default_rng(7)
    size, electrons = 512, np.full((512, 512), SKY_E)
    uv = scattered(rng, 36, size)
    down, across = np.mgrid[:size, :size]
    for u, v in uv:
        electrons += 10 ** rng.uniform(4.3, 5.3) * ring(radius_px, across - u, down - v)
    extraction = EXTRACT(expose(electrons, rng))
    index, false = found(extraction, uv)
    assert np.count_nonzero(index >= 0) >= 30
    assert false <= 2
    error = extraction.centroids.uv[index[index >= 0]] - uv[index >= 0]
    assert np.sqrt(np.mean(error ** 2)) < 0.3
    assert np.sqrt(np.trace(extraction.centroids.correlated_error)) < radius_px / 10


def test_close_pair_is_resolved():
    rng = np.random.default_rng(7)
    first = scattered(rng, 36, 512)
    angle = rng.uniform(0, 2 * np.pi, 36)
    uv = np.concatenate([first, first + 5 * np.stack([np.cos(angle), np.sin(angle)], 1)])
    flux = np.repeat([20000.0, 8000.0], 36)
    result = EXTRACT(expose(SKY_E + light((512, 512), uv, flux, 0.8), rng))
    index, false = found(result, uv)
    assert (index >= 0).all() and false == 0
    error = result.centroids.uv[index] - uv
    assert np.abs(error.mean(0)).max() < 0.004
    assert (error ** 2 / result.centroids.sigma_px[index, None] ** 2).mean() < 1.2


def test_saturated_stars_are_fitted_by_their_flanks_or_rejected():
    rng = np.random.default_rng(8)
    uv = scattered(rng, 16, 512)
    flux = np.repeat([8e3, 6e4, 1e6, 3e7], 4)
    image = expose(SKY_E + light((512, 512), uv, flux, 0.8), rng, top=4095)
    result = EXTRACT(image)
    index, false = found(result, uv)
    assert (index[:8] >= 0).all() and (index[12:] < 0).all() and false == 0
    assert sum(result.rejected.values()) >= 4
    seen = index >= 0
    error = (result.centroids.uv[index] - uv)[seen]
    assert (np.abs(error) < 5 * result.centroids.sigma_px[index[seen], None]).all()
    np.testing.assert_allclose(result.centroids.flux[index[4:8]] * GAIN_E_PER_DN, 6e4, rtol=0.05)


def test_the_moon_hides_only_the_stars_beside_it():
    """The mesh of the background blurs its rim by a tile: beyond that nothing is lost."""
    rng = np.random.default_rng(9)
    uv = scattered(rng, 25, 1024)
    y, x = np.mgrid[:1024, :1024]
    uv = uv[np.hypot(*(uv - [620, 400]).T) > 80 + 1.25 * TILE_PX]
    moon = 40000.0 * (np.hypot(x - 620, y - 400) < 80)
    result = EXTRACT(expose(SKY_E + moon + light((1024, 1024), uv, 20000.0, 0.8), rng))
    index, false = found(result, uv)
    assert (index >= 0).all() and false <= 1
    assert result.rejected['disc'] > 0


def test_of_a_dense_field_the_brightest_stars_are_found():
    """More peaks than one in 400 pixels, in a small image of a wide field."""
    rng = np.random.default_rng(0)
    bright = rng.uniform(10, 390, (40, 2))
    bright = bright[(np.linalg.norm(bright[:, None] - bright, axis=2) > 12).sum(1)
                    == len(bright) - 1]
    faint = rng.uniform(0, 400, (1500, 2))
    faint = faint[np.linalg.norm(faint[:, None] - bright, axis=2).min(axis=1) > 6]
    image = expose(SKY_E + light((400, 400), bright, 20000.0, 0.8)
                   + light((400, 400), faint, 700.0, 0.8), rng)
    result = EXTRACT(image)
    assert result.status == 'ok'
    brightest = result.centroids.uv[:len(bright)]
    distance = np.linalg.norm(brightest[:, None] - bright, axis=2)
    assert (distance.min(axis=0) < 0.3).mean() > 0.9


@pytest.mark.parametrize('make, status', [
    (lambda: np.zeros((480, 640), np.uint8), 'blank'),
    (lambda: np.full((480, 640), 65535, np.uint16), 'blank'),
    (lambda: np.full((1, 1), 7, np.uint16), 'too_small'),
    (lambda: np.arange(500, dtype=np.uint16)[None], 'too_small'),
    (lambda: np.arange(500, dtype=np.uint16)[:, None], 'too_small'),
    (lambda: np.where(np.random.default_rng(0).random((300, 300)) < 0.8, 255, 20).astype(
        np.uint8), 'saturated'),
    (lambda: np.where(np.random.default_rng(0).random((600, 600)) < 0.03, 60000, 100).astype(
        np.uint16), 'no_stars'),
    (lambda: np.random.default_rng(0).normal(1000, 12, (4096, 4096)).astype(np.uint16),
     'no_stars'),
    (lambda: np.random.default_rng(0).integers(0, 65536, (300, 300)).astype(np.uint16),
     'no_stars'),
    (lambda: np.random.default_rng(0).normal(1000, 12, (8, 3000)).astype(np.uint16),
     'no_stars'),
    (lambda: np.pad([[200]], 40).astype(np.uint8), 'no_stars'),
    (lambda: np.full((2048, 2048), 255, np.uint8), 'blank'),
])
def test_an_image_without_stars_has_a_status_and_a_reason(make, status):
    result = EXTRACT(make())
    assert result.status == status and result.reason
    assert len(result.centroids) == 0
    if status == 'no_stars':
        # What is there, and what to do.
        assert (f'none of {sum(result.rejected.values())} detections is a star (' in result.reason
                if result.rejected else 'no star image above 5.5 sigma' in result.reason)
        assert ': expose ' in result.reason or ': subtract a dark frame' in result.reason


@pytest.mark.parametrize('image, words', [
    (np.zeros((10, 10)), 'float64'),
    (np.zeros((10, 10), np.float32), 'float32'),
    (np.full((10, 10), np.nan), 'float64'),
    (np.zeros((10, 10), np.int32), 'int32'),
    (np.zeros((10, 10), '>u2'), '>u2'),
    ([[1, 2], [3, 4]], 'list'),
    (np.zeros((10, 10, 3), np.uint8), '3 dimensions'),
    (np.zeros(10, np.uint8), '1 dimensions'),
    (np.zeros((0, 10), np.uint8), 'empty'),
])
def test_wrong_images_are_rejected_with_their_type_or_shape(image, words):
    with pytest.raises(ValueError, match=words):
        EXTRACT(image)


def test_options_have_their_effect_and_the_image_is_unchanged():
    rng = np.random.default_rng(10)
    uv = scattered(rng, 36, 512)
    image = expose(SKY_E + light((512, 512), uv, np.geomspace(1500, 50000, 36), 0.8), rng)
    before = image.copy()
    every = EXTRACT(image)
    few = CentroidExtractor(ExtractionOptions(max_stars=5)).measure(image)
    np.testing.assert_allclose(few.centroids.uv, every.centroids.uv[:5], atol=0.02)
    given = CentroidExtractor(ExtractionOptions(psf_sigma_px=0.8)).measure(image)
    assert given.psf_sigma_px == 0.8
    np.testing.assert_allclose(given.centroids.uv[:20], every.centroids.uv[:20], atol=0.02)
    strict = CentroidExtractor(ExtractionOptions(threshold_sigma=40.0)).measure(image)
    assert 0 < len(strict.centroids) < len(every.centroids)
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(EXTRACT(image[:, ::-1][:, ::-1]).centroids.uv,
                                  every.centroids.uv)
    assert every.background_dn == pytest.approx(SKY_E / GAIN_E_PER_DN + OFFSET_DN, abs=1)
    assert every.noise_dn == pytest.approx(300 ** 0.5 / GAIN_E_PER_DN, rel=0.1)


def test_real_photographs_of_wide_field(sky_data):
    """Centroids are catalogue stars, to 0.15 px after a fit of the residual distortion."""
    folder = sky_data / 'night-sky-11deg'
    catalog = load_catalog()
    directions = catalog.directions(2019.57)
    with open(folder / 'solutions.csv') as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    for row in rows:
        result = EXTRACT(cv2.imread(str(folder / row['file']), cv2.IMREAD_UNCHANGED))
        uv = result.centroids.uv
        assert 50 <= len(uv) <= 150
        camera = Camera.from_fov(1024, 768, float(row['hfov_deg']))
        q_icrf_from_sensor = np.array([float(row[name]) for name in ('qx', 'qy', 'qz', 'qw')])
        stars = camera.project(rotate(conjugate(q_icrf_from_sensor), directions))
        inside = camera.contains(stars)
        stars, magnitude = stars[inside], catalog.magnitude[inside]
        distance, index = cKDTree(stars).query(uv)
        known = distance < 3
        # Milky Way fields hold more than the catalogue, which ends at V = 9
        assert known.mean() > 0.75
        bright = stars[(magnitude < 6) & camera.contains(stars, 3)]
        assert (cKDTree(uv).query(bright)[0] < 3).mean() > 0.85
        x, y = ((stars[index[known]] - [511.5, 383.5]) / 500).T
        terms = np.stack([x ** i * y ** j for i in range(4) for j in range(4 - i)], 1)
        offset = uv[known] - stars[index[known]]
        weight = 1 / np.hypot(result.centroids.sigma_px[known], 0.05)[:, None]
        fit = np.linalg.lstsq(terms * weight, offset * weight, rcond=None)[0]
        assert np.sqrt(np.median((offset - terms @ fit) ** 2) / 0.455) < 0.15


def test_real_photographs_of_narrow_field(sky_data):
    """High gain, background cut off at zero, hot pixels: few stars, hardly a false one."""
    paths = sorted((sky_data / 'night-sky-6deg').glob('*.png'))
    assert len(paths) == 6
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        result = EXTRACT(image)
        assert result.status == 'ok'
        assert len(result.centroids) <= 20
    image = cv2.imread(str(sky_data / 'night-sky-6deg' / 'img3.png'), cv2.IMREAD_GRAYSCALE)
    assert 9 <= len(EXTRACT(image).centroids) <= 14
