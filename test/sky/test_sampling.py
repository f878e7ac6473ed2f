"""The table sampler draws from exactly the distribution it was given."""

import numpy as np
import pytest
from scipy.stats import chisquare

from startracker_ros.sky.sampling import TableSampler


@pytest.mark.parametrize('weight', [
    [0.25, 0.75], [1.0], [1e-6, 3e-6, 0.1, 0.899996], 1 / np.arange(1, 400) ** 3.0])
def test_frequencies_follow_the_probabilities(weight):
    probability = np.array(weight) / np.sum(weight)
    values = np.arange(7, 7 + len(probability), dtype=np.uint16)
    sample = TableSampler(values, probability).draw(4_000_003, np.random.default_rng(3))
    assert sample.shape == (4_000_003,) and sample.dtype == np.uint16
    count = np.bincount(sample, minlength=values[-1] + 1)[7:]
    expected = probability * len(sample)
    usual = expected >= 5
    # Rare values, also those below one table cell, are counted together.
    observed = np.append(count[usual], count[~usual].sum())
    wanted = np.append(expected[usual], expected[~usual].sum())
    keep = wanted > 0
    assert chisquare(observed[keep], wanted[keep]).pvalue > 1e-3 or keep.sum() == 1


def test_neighbouring_draws_are_independent():
    sample = TableSampler(np.arange(50), np.full(50, 0.02)).draw(
        1_000_000, np.random.default_rng(4)).astype(float)
    sample -= sample.mean()
    for lag in (1, 2, 3, 4, 1024):
        correlation = (sample[lag:] * sample[:-lag]).mean() / sample.var()
        assert abs(correlation) < 4e-3
