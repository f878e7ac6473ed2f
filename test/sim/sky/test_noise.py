# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The noise draws from the distributions it claims, and never the same twice."""

from zlib import crc32

import numpy as np
import pytest
from scipy.stats import chisquare, kurtosis, norm, poisson
from startracker_ros.sim.sky.noise import noise_tables, read_out, readout

TABLES = noise_tables()


def drawn(mean, key, *, read_noise_e=0.0, dn_per_e=1.0, bias_dn=0.0, full_well_e=6e4):
    image = np.empty(np.size(mean), np.uint16)
    read_out(np.asarray(mean, np.float32), key,
             readout(full_well_e, read_noise_e, dn_per_e, bias_dn, 65535), TABLES, None, image)
    return image


def chance(observed, expected):
    usual = expected > 5
    observed = np.append(observed[usual], observed[~usual].sum())
    # An empty remainder counts as one half expected and none seen: it decides nothing.
    expected = np.append(expected[usual], max(expected[~usual].sum(), 0.5))
    return chisquare(observed, expected * observed.sum() / expected.sum()).pvalue


# 0.24 is all rest, 0.25 none of it; 63.99 and 64 are either side of the two ways to draw.
@pytest.mark.parametrize('mean', [0.01, 0.24, 0.25, 3.1, 20.0, 63.99, 64.0, 70.3, 400.7, 9000.0])
def test_counts_are_poisson(mean):
    counts = drawn(np.full(4_000_000, mean), 3)
    level = np.arange(counts.max() + 1)
    expected = poisson.pmf(level, mean) * counts.size
    expected[-1] += poisson.sf(level[-1], mean) * counts.size
    assert chance(np.bincount(counts), expected) > 1e-3


@pytest.mark.parametrize('mean', [0.0, -0.3, -1e30, np.nan])
def test_nothing_falls_in_the_dark(mean):
    assert not drawn(np.full(100_000, mean), 1).any()


def test_read_noise_is_normal():
    """Down to bins of a fiftieth of sigma and out to five sigma."""
    image = drawn(np.zeros(8_000_000), 5, read_noise_e=50.0, bias_dn=1000.0)
    value = np.arange(1 << 16)
    expected = np.diff(norm.cdf(value + 0.5, 1000, 50), prepend=0.0) * image.size
    assert chance(np.bincount(image, minlength=1 << 16), expected) > 1e-3
    normal = (image - 1000.0) / 50
    assert abs(normal.mean()) < 5 / np.sqrt(normal.size)
    assert abs(normal.var() - 1) < 5 * np.sqrt(2 / normal.size) + 1 / 12 / 2500
    assert abs(kurtosis(normal)) < 5 * np.sqrt(24 / normal.size)
    assert (np.abs(normal) > 4).mean() == pytest.approx(2 * norm.sf(4), rel=0.3)


def test_each_pixel_has_its_own_mean():
    """Bright and dark pixels side by side, as in a star field."""
    mean = np.tile(np.r_[np.full(300, 5.0), 500.0, 30.2, 64.0, np.linspace(0, 900, 300)], 3000)
    image = drawn(mean, 11).reshape(3000, -1).astype(float)
    mean = mean.reshape(3000, -1)[0]
    pull = (image.mean(0) - mean) / np.sqrt(np.maximum(mean, 1e-9) / 3000)
    assert np.abs(pull).max() < 5 and pull.std() == pytest.approx(1, abs=0.15)
    lit = mean > 1
    assert (image.var(0)[lit] / mean[lit]).mean() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize('mean', [20.3, 300.0])
def test_no_correlation_between_pixels_or_frames(mean):
    frames = [drawn(np.full(1 << 20, mean), key, read_noise_e=5.0, bias_dn=100.0).astype(float)
              for key in (1, 2, 3, 2 ** 63 + 1)]
    frames = [(frame - frame.mean()) / frame.std() for frame in frames]
    size = frames[0].size
    for lag in (1, 2, 3, 4, 8, 255, 256, 257, 1024, 4096):
        assert abs((frames[0][lag:] * frames[0][:-lag]).mean()) < 5 / np.sqrt(size - lag)
    for i in range(4):
        for j in range(i):
            # As they are, and with one shifted against the other: no stretch comes again.
            spectrum = np.fft.rfft(frames[i]) * np.conj(np.fft.rfft(frames[j]))
            assert np.abs(np.fft.irfft(spectrum) / size).max() < 6 / np.sqrt(size)


def test_photon_and_read_noise_are_independent():
    """The variance of the sum is the sum of the variances; the third moment is the photons'."""
    image = drawn(np.full(4_000_000, 30.0), 8, read_noise_e=4.0, bias_dn=200.0) - 230.0
    assert image.var() == pytest.approx(30 + 16 + 1 / 12, rel=5 * np.sqrt(2 / image.size))
    assert (image ** 3).mean() == pytest.approx(30, abs=5 * np.sqrt(15 * 46 ** 3 / image.size))


def test_full_well_holds_before_the_amplifier():
    image = drawn(np.full(100_000, 5000.0), 2, read_noise_e=3.0, full_well_e=1000.0)
    assert image.mean() == pytest.approx(1000, abs=0.1)
    assert image.std() == pytest.approx(3.0, rel=0.03)


def test_same_key_same_image():
    mean = np.linspace(0, 200, 10_001)
    np.testing.assert_array_equal(drawn(mean, 4), drawn(mean, 4))
    assert (drawn(mean, 4) != drawn(mean, 5)).mean() > 0.8


def test_images_are_those_of_every_version():
    """Recorded bags are compared with images that are rendered again."""
    mean = (np.arange(100_000) / 1000) ** 2
    image = drawn(mean, 2 ** 64 - 3, read_noise_e=4.0, dn_per_e=0.7, bias_dn=33.3)
    assert crc32(image.tobytes()) == 3058324293
