# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of stars: centroid, light, background and noise."""

from dataclasses import replace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.stats import chi2, chisquare, norm, poisson
from skies import CAMERA as FULL_CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.detector import Detector, DetectorOptions

CAMERA = Camera.from_fov(64, 48, 2.0)
# Fine steps and a deep well: what is left is the rounding to a sixteenth part of 0.25 e-.
EXACT = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)
NOBODY = np.zeros((0, 2)), np.zeros(0)


def draw(options, uv, magnitude, seed=1, camera=CAMERA):
    return Detector(camera, options).render(
        np.reshape(uv, (-1, 2)), np.atleast_1d(magnitude), np.random.default_rng(seed))


def centre_of_light(image):
    row, column = np.indices(image.shape)
    return np.array([(image * column).sum(), (image * row).sum()]) / image.sum()


@given(st.floats(10, 53), st.floats(10, 37), st.sampled_from([0.7, 0.8, 1.3]))
@settings(max_examples=20)
def test_centroid_is_the_pixel_of_the_star(u, v, sigma_px):
    # Below 0.7 px the pixels sample the star too coarsely for a centre of light to be true:
    # its error is exp(-2 pi^2 sigma^2) / pi px, on a real sensor just as here.
    image = draw(replace(EXACT, psf_sigma_px=sigma_px), (u, v), 3.0).astype(float)
    assert np.abs(centre_of_light(image) - (u, v)).max() < 1e-3


@given(st.floats(10, 53), st.floats(10, 37))
@settings(max_examples=20)
def test_light_is_what_the_magnitude_promises(u, v):
    detector = Detector(CAMERA, EXACT)
    sums = [draw(EXACT, (u, v), magnitude).astype(float).sum() for magnitude in (2.5, 7.5)]
    assert sums[0] == pytest.approx(detector.flux_dn(2.5), rel=5e-4)
    assert sums[1] == pytest.approx(detector.flux_dn(7.5), rel=3e-2)
    assert detector.flux_e(2.5) / detector.flux_e(7.5) == pytest.approx(100.0)


def test_light_of_close_stars_adds_up():
    both = draw(EXACT, [(30.2, 20.4), (32.1, 21.3)], [4.0, 5.0]).astype(float)
    alone = sum(draw(EXACT, uv, magnitude).astype(float) for uv, magnitude in (
        ((30.2, 20.4), 4.0), ((32.1, 21.3), 5.0)))
    assert np.abs(both - alone).max() <= 1.0


def test_a_star_slides_in_over_the_edge():
    """No jump where a star enters the margin, and the part inside is that of a full image."""
    detector = Detector(CAMERA, EXACT)
    outside = -0.5 - detector.margin_px
    assert draw(EXACT, (outside - 1e-6, 20.0), 2.0).max() == 0
    assert draw(EXACT, (outside + 1e-6, 20.0), 2.0).max() <= 1
    wide = Camera.from_fov(64 + 32, 48 + 32, 2.0)
    for uv in ((-1.3, 10.2), (63.9, 47.7), (20.0, -3.0), (65.2, -0.4)):
        full = draw(EXACT, np.add(uv, 16), 2.0, camera=wide)
        np.testing.assert_array_equal(draw(EXACT, uv, 2.0), full[16:-16, 16:-16])
    for uv in ((-500.0, 20.0), (20.0, 1e6)):
        assert draw(EXACT, uv, 2.0).max() == 0


@pytest.mark.parametrize('change', [
    {}, {'background_e': 0.0}, {'background_e': 1.5, 'read_noise_e': 0.5, 'gain_e_per_dn': 0.5},
    {'background_e': 900.0, 'gain_e_per_dn': 0.25, 'bit_depth': 16}, {'bias_dn': 0.0},
    {'bit_depth': 8, 'gain_e_per_dn': 16.0, 'bias_dn': 4.0}, {'full_well_e': 100.0,
                                                              'background_e': 95.0}])
def test_background_is_poisson_plus_read_noise(change):
    """Chi-square against an integral over counts that shares nothing with the renderer."""
    options = replace(DetectorOptions(), **change)
    image = draw(options, *NOBODY, camera=FULL_CAMERA)
    electrons = np.arange(0, 2000)
    weight = poisson.pmf(electrons, options.background_e)
    collected = np.minimum(electrons, options.full_well_e)
    level = np.arange(0, image.max() + 20.0)
    edge = (np.append(level[:-1] + 0.5, np.inf) - options.bias_dn) * options.gain_e_per_dn
    below = sum(w * norm.cdf(edge, c, options.read_noise_e)
                for w, c in zip(weight, collected) if w > 1e-14)
    expected = np.diff(below, prepend=0.0) * image.size
    observed = np.bincount(image.ravel(), minlength=len(level)).astype(float)
    usual = expected > 5
    observed = np.append(observed[usual], observed[~usual].sum())
    expected = np.append(expected[usual], expected[~usual].sum())
    assert chisquare(observed, expected * observed.sum() / expected.sum()).pvalue > 1e-3


def test_background_mean_and_variance():
    options = DetectorOptions(gain_e_per_dn=1.0)
    image = draw(options, *NOBODY, camera=FULL_CAMERA).astype(float)
    variance = 20.0 + 5.0 ** 2 + 1 / 12
    assert image.mean() == pytest.approx(84.0, abs=5 * np.sqrt(variance / image.size))
    assert image.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / image.size))


def test_noise_of_starlight():
    """Over many exposures every pixel has the mean of the noise-free image and its variance."""
    options = DetectorOptions(gain_e_per_dn=1.0, bit_depth=14)
    uv, magnitude = [(30.3, 20.4), (33.0, 22.6)], [3.5, 6.0]
    detector, rng, trials = Detector(CAMERA, options), np.random.default_rng(5), 1500
    frames = np.array([detector.render(np.array(uv), np.array(magnitude), rng)[14:30, 24:40]
                       for _ in range(trials)], float)
    # The fine steps give the expectation before rounding.
    bright = draw(replace(EXACT, background_e=20.0), uv, magnitude)[14:30, 24:40] / 4
    variance = bright + 25.0 + 1 / 12
    pull = (frames.mean(0) - 64.0 - bright) / np.sqrt(variance / trials)
    assert 1e-3 < chi2.sf((pull ** 2).sum(), pull.size) < 0.999
    ratio = frames.var(0, ddof=1) / variance
    assert abs(ratio.mean() - 1) < 5 * np.sqrt(2 / trials / ratio.size)
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / trials)


def test_sixth_magnitude_has_the_promised_signal_to_noise():
    options = DetectorOptions()
    signal = Detector(CAMERA, options).flux_e(6.0)
    pixels = 4 * np.pi * options.psf_sigma_px ** 2
    noise = np.sqrt(signal + pixels * (options.background_e + options.read_noise_e ** 2))
    assert signal / noise == pytest.approx(23, abs=1)


def test_full_well_and_full_scale():
    assert draw(replace(EXACT, full_well_e=5000.0), (30, 20), -1.0).max() == 20000
    eight = draw(DetectorOptions(bit_depth=8), (30, 20), -1.0)
    assert eight.dtype == np.uint8 and eight.max() == 255 and eight[:5].max() < 100
    twelve = draw(DetectorOptions(full_well_e=1e6), (30, 20), -1.0)
    assert twelve.dtype == np.uint16 and twelve.max() == 4095


def test_same_generator_same_image():
    star = (30.2, 20.1), 4.0
    np.testing.assert_array_equal(draw(DetectorOptions(), *star), draw(DetectorOptions(), *star))
    assert (draw(DetectorOptions(), *star) != draw(DetectorOptions(), *star, seed=2)).any()
    quiet = DetectorOptions(noise=False)
    np.testing.assert_array_equal(draw(quiet, *star), draw(quiet, *star, seed=2))


def test_extreme_options_are_possible():
    image = draw(DetectorOptions(background_e=5000.0, read_noise_e=100.0, gain_e_per_dn=0.25,
                                 bit_depth=16), *NOBODY)
    assert image.mean() == pytest.approx(20064, abs=5 * 4 * np.sqrt(15000 / image.size))
