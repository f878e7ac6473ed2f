# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The false-alarm probability and the test of the lens, each against its definition."""

from math import factorial

from native_core import call, kernels
import numpy as np
import pytest
from scipy.stats import binom, chi2
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core import native
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.star_matcher import Rules, StarMatcher

SIGMA = 1e-4
RADIUS = 3.5 * SIGMA
CHANCE = 1e-4


@pytest.fixture(autouse=True)
def library_for_tests(monkeypatch):
    monkeypatch.setattr(native, 'library', kernels)


@pytest.mark.parametrize('product', [1e-30, 1e-12, 1e-3, 0.2, 1.0])
def test_four_probabilities_are_combined_as_fisher_does(product):
    """Minus twice the logarithm of n uniform numbers' product is chi-square with 2 n degrees."""
    assert call('stt_fisher_combined', product) == pytest.approx(
        chi2.sf(-2 * np.log(product), 8), rel=1e-9)


@pytest.mark.parametrize('n', [1, 54, 1000])
@pytest.mark.parametrize('p', [0.0, 1e-6, 0.003, 0.4, 0.6, 0.99, 1 - 1e-6, 1 - 1e-12, 1.0])
def test_matches_by_chance_have_the_binomial_tail(n, p):
    """That of a nearly certain match too, whose misses are less probable than any number."""
    for m in (0, 1, n // 3, n - 1, n):
        assert call('stt_binomial_tail', m, n, p) == pytest.approx(
            binom.sf(m - 1, n, p), rel=1e-9, abs=1e-290)


@pytest.mark.parametrize('n', [5, 12, 30])
@pytest.mark.parametrize('tested', [1, 1e3, 1e6])
def test_the_least_matches_are_those_of_the_definition(n, tested):
    p, share, most = 0.002, 0.1, 1e-5

    def false_alarm(m):
        residuals = (2 * m / 3.5 ** 2) ** (m - 3) / factorial(m - 3)
        product = (binom.sf(m - 4, n - 3, p) * share * min(residuals, 1) / factorial(m))
        return tested * chi2.sf(-2 * np.log(product), 8)
    accepted = [m for m in range(4, min(n, 6) + 1) if false_alarm(m) <= most]
    least = call('stt_least_matches', n, p, share, 3, 3.5, tested, most)
    assert accepted[0] == least if accepted else least > min(n, 6)
    # More noise, more candidates or fewer stars never need fewer matches.
    assert least <= call('stt_least_matches', n, 4 * p, share, 3, 3.5, 100 * tested, most)


def rejected(matches, misses, residual_sigmas, blended=False, false=0):
    """Return whether a field on a grid of stars is rejected, its misses three radii off."""
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9))
    seen = np.stack([x.ravel(), y.ravel()], -1)[:matches + misses + false]
    direction = np.column_stack([seen, np.ones(len(seen))])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    known = matches + misses
    sky = OnboardCatalog(np.arange(known, dtype=np.int32), direction[:known], np.full(known, 5.0),
                         np.zeros(known, bool), np.full(known, blended))
    seen[matches:, 0] += 3 * RADIUS
    seen[matches + misses:, 0] += 100 * RADIUS
    star, residual = np.full(len(seen), -1, np.int32), np.full(len(seen), np.nan)
    star[:matches], residual[:matches] = np.arange(matches), residual_sigmas * SIGMA
    matcher = StarMatcher(CAMERA, sky, {}, Rules(0.005))
    return call('stt_lens_mismatch', matcher._tracker.handle, seen, star, residual, len(seen),
                RADIUS, SIGMA, matches - 3, CHANCE)


@pytest.mark.slow
def test_few_near_misses_do_not_outweigh_many_close_matches():
    assert not rejected(30, 6, 0.8)
    assert rejected(10, 15, 0.8)


def test_matches_no_closer_than_by_chance_do_not_outweigh_near_misses():
    assert not rejected(12, 4, 0.8)
    # The mean square of a uniform distribution over the disc is half of its radius squared.
    assert rejected(12, 4, 3.5 / np.sqrt(2))


def test_without_more_near_misses_than_by_chance_nothing_is_rejected():
    assert not rejected(12, 0, 3.4)
    assert not rejected(5, 1, 3.4, false=40)


def test_near_misses_of_blended_entries_are_not_counted():
    assert rejected(6, 8, 0.8)
    assert not rejected(6, 8, 0.8, blended=True)
