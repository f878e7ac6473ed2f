"""Steps found and dated, none where there is none."""

import numpy as np
from startracker_ros.trend.steps import drift, find_steps

ORBIT_S, BIN_S = 5800.0, 60.0
MIX = np.array([[0.1, 0.0, 0.0], [0.3, 0.8, 0.0], [0.2, 0.3, 0.1]])


def series(days, seed=1):
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(days * 86400 / BIN_S)) * BIN_S
    values = rng.normal(size=(len(time_s), 3)) @ MIX
    values[:, 0] += 0.5 * time_s / 86400 + 0.3 * np.sin(2 * np.pi * time_s / ORBIT_S)
    return (time_s * 1e9).astype(np.int64) + 10 ** 18, values


def test_a_clean_series_has_no_step():
    stamps, values = series(10)
    assert find_steps(stamps, values, ORBIT_S) == []
    np.testing.assert_allclose(drift(stamps, values, [])[0], 0.5, atol=0.02)


def test_two_steps_are_found_over_a_gap():
    stamps, values = series(2)
    values[1000:, 0] += 1.0
    values[2000:, 2] -= 0.5
    keep = np.r_[0:1300, 1420:len(stamps)]
    found = sorted(find_steps(stamps[keep], values[keep], ORBIT_S), key=lambda s: s.stamp_ns)
    assert len(found) == 2
    for step, index, column, size in zip(found, (1000, 2000), (0, 2), (1.0, -0.5)):
        assert abs(step.stamp_ns - stamps[index]) * 1e-9 < ORBIT_S / 10
        assert abs(step.size[column] - size) < 4 * step.sigma[column]


def test_noise_that_is_not_white_is_no_step():
    stamps, values = series(6)
    values += np.cumsum(np.random.default_rng(4).normal(0, 0.01, values.shape), axis=0)
    assert len(find_steps(stamps, values, ORBIT_S)) == 0


def test_too_short_or_empty_series_have_none():
    stamps, values = series(0.02)
    assert find_steps(stamps, values, ORBIT_S) == []
    assert find_steps(stamps[:0], values[:0], ORBIT_S) == []
