# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Intervals contain the truth as often as they say."""

import numpy as np
import pytest
from scipy import stats
from startracker_ros.tools.night import intervals

TRIALS = 400
# Of so many intervals so many contain the truth, but for one run in a thousand.
FEWEST, MOST = stats.binom.ppf([0.0005, 0.9995], TRIALS, intervals.CONFIDENCE)


def covered(interval_of, truth):
    rng = np.random.default_rng(5)
    found = [interval_of(rng) for _ in range(TRIALS)]
    return sum(each.low <= truth <= each.high for each in found)


@pytest.mark.parametrize('drift', (0.0, 0.02))
def test_the_noise_of_a_drifting_series(drift):
    def of(rng):
        values = rng.normal(0, 3.0, (60, 2)) + drift * np.arange(60)[:, None]
        return intervals.successive_sigma(values, np.ones(59, bool))
    assert FEWEST <= covered(of, 3.0) <= MOST


def test_neighbours_over_a_gap_are_not_noise():
    values = np.r_[np.zeros(20), np.full(20, 1e3)][:, None]
    joined = np.ones(39, bool)
    joined[19] = False
    assert intervals.successive_sigma(values, joined).value == 0


@pytest.mark.parametrize('degree', (1, 2))
def test_a_trend_in_noise(degree):
    time_s = np.linspace(-1, 1, 80)

    def of(rng):
        return intervals.block_trend(
            time_s, 0.7 * time_s ** degree + rng.normal(0, 0.5, 80), degree)
    assert FEWEST <= covered(of, 0.7) <= MOST


def wander(rng):
    """Return noise (200,) of standard deviation 1 whose neighbours share three parts of four."""
    white = rng.normal(0, 0.5, 203)
    return white[:-3] + white[1:-2] + white[2:-1] + white[3:]


def test_a_trend_and_a_mean_of_correlated_neighbours():
    time_s = np.linspace(-1, 1, 200)

    def trend(rng):
        return intervals.block_trend(time_s, 0.7 * time_s + wander(rng), 1)

    def mean(rng):
        return intervals.block_mean(1.5 + wander(rng))
    # White noise of this size would cover half as wide: 67 %.
    assert covered(trend, 0.7) >= 0.9 * TRIALS
    assert covered(mean, 1.5) >= 0.9 * TRIALS


def test_the_mean_of_correlated_chi_squares():
    def of(rng):
        return intervals.chi_square_mean(sum(wander(rng) ** 2 for _ in range(3)), 3)
    assert covered(of, 1.0) >= 0.9 * TRIALS


def test_shares_are_those_of_clopper_and_pearson():
    found = intervals.share(8, 10)
    exact = stats.binomtest(8, 10).proportion_ci(method='exact')
    assert found == pytest.approx((80, 100 * exact.low, 100 * exact.high))
    assert intervals.share(0, 5).low == 0 and intervals.share(5, 5).high == 100


def test_too_few_values_have_no_interval():
    nothing = [intervals.block_mean(np.zeros(5)), intervals.share(0, 0),
               intervals.block_trend(np.arange(5.0), np.zeros(5), 1),
               intervals.successive_sigma(np.zeros((2, 1)), np.ones(1, bool))]
    assert all(np.isnan(each.value) for each in nothing)
