# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps found and dated, none where there is none."""

import numpy as np
from startracker_ros.tools.trend.steps import _fits, drift, find_steps, WINDOW_ORBITS

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
    assert find_steps(stamps, values, ORBIT_S).steps == []
    np.testing.assert_allclose(drift(stamps, values, [])[0], 0.5, atol=0.02)


def test_two_steps_are_found_over_a_gap():
    stamps, values = series(2)
    values[1000:, 0] += 1.0
    values[2000:, 2] -= 0.5
    keep = np.r_[0:1300, 1420:len(stamps)]
    found = sorted(find_steps(stamps[keep], values[keep], ORBIT_S).steps, key=lambda s: s.stamp_ns)
    assert len(found) == 2
    for step, index, column, size in zip(found, (1000, 2000), (0, 2), (1.0, -0.5)):
        assert abs(step.stamp_ns - stamps[index]) * 1e-9 < ORBIT_S / 10
        assert abs(step.size[column] - size) < 4 * step.sigma[column]


def test_noise_that_is_not_white_is_not_a_step():
    stamps, values = series(6)
    values += np.cumsum(np.random.default_rng(4).normal(0, 0.01, values.shape), axis=0)
    assert find_steps(stamps, values, ORBIT_S).steps == []


def test_too_short_or_empty_series_have_none():
    stamps, values = series(0.02)
    assert find_steps(stamps, values, ORBIT_S).steps == []
    assert find_steps(stamps[:0], values[:0], ORBIT_S).steps == []


def test_steps_above_the_stated_smallest_one_are_found_and_below_it_are_not():
    stamps, values = series(3)
    least = find_steps(stamps, values, ORBIT_S).least
    for column in range(3):
        for share, count in ((1.6, 1), (0.4, 0)):
            stepped = values.copy()
            stepped[2000:, column] += share * least[column]
            assert len(find_steps(stamps, stepped, ORBIT_S).steps) == count


def test_the_fit_of_running_sums_is_that_of_least_squares():
    stamps, values = series(4)
    white = values[:, :1] / values[:, :1].std()
    time_s = (stamps - stamps[0]) * 1e-9
    keep = np.r_[0:900, 1000:len(stamps)]
    size, variance = _fits(time_s[keep], white[keep], ORBIT_S)
    for date in (700, 2500, len(keep) - 300):
        t = time_s[keep] - time_s[keep][date]
        near = np.abs(t) < WINDOW_ORBITS * ORBIT_S
        t, phase = t[near], 2 * np.pi * t[near] / ORBIT_S
        design = np.stack([t >= 0, np.ones(len(t)), t / ORBIT_S, np.sin(phase), np.cos(phase),
                           np.sin(2 * phase), np.cos(2 * phase)], -1)
        expected = np.linalg.lstsq(design, white[keep][near, 0], rcond=None)[0][0]
        covariance = np.linalg.inv(design.T @ design)
        np.testing.assert_allclose(size[date - 20, 0], expected, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(variance[date - 20], covariance[0, 0], rtol=1e-4)
