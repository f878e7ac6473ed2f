# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The bound of smeared stars is one, ours is near it, and a row can fail."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_evaluation.bench.smear import (
    bounds_px, Errors, flux_of, measure, random_scene, rows, run_smear_bench, SNRS, STREAKS_PX)

RNG_SEED = 4


def scene_of(length_px, angle=0.5):
    direction = np.array([np.cos(angle), np.sin(angle)])
    return replace(random_scene(length_px, np.random.default_rng(RNG_SEED)),
                   streak_px=length_px * direction)


def test_the_light_is_a_streak_of_that_length():
    scene = scene_of(12.0)
    share = scene.shares(np.zeros(2))
    assert share.sum(axis=(1, 2)) == pytest.approx(1, abs=2e-3)
    pixel = np.stack(np.meshgrid(*[np.arange(share.shape[1]) - share.shape[1] // 2] * 2), -1)
    offset = pixel + np.rint(scene.uv)[:, None, None] - scene.uv[:, None, None]
    along, across = np.moveaxis(offset @ scene.axes.T, -1, 0)
    # A uniform streak, the Gaussian, and the square pixels.
    assert (share * along).sum(axis=(1, 2)) == pytest.approx(0, abs=0.03)
    assert (share * along ** 2).sum(axis=(1, 2)) == pytest.approx(144 / 12 + 0.8 ** 2 + 1 / 12,
                                                                  rel=0.02)
    assert (share * across ** 2).sum(axis=(1, 2)) == pytest.approx(0.8 ** 2 + 1 / 12, rel=0.03)


def test_the_bound_of_a_bright_star_is_that_of_its_photons():
    scene, flux_e = scene_of(10.0, 0.0), 1e8
    along, across = bounds_px(scene, scene.shares(np.zeros(2)), flux_e).T
    assert across * np.sqrt(flux_e) == pytest.approx(np.hypot(0.8, 12 ** -0.5), rel=0.03)
    assert (along > 1.3 * across).all()


def test_the_flux_of_an_snr():
    share = np.full((2, 2), 0.25)
    flux_e = flux_of(20.0, share)
    assert flux_e / np.sqrt(flux_e + 4 * (20 + 25 + 16 / 12)) == pytest.approx(20)


def test_ours_is_near_the_bound():
    errors = measure(5.0, 30.0, 3, seed=1)
    assert len(errors.error_px) == errors.stars == 75
    for row in rows(5.0, 30.0, errors):
        assert row.holds and row.ratio == pytest.approx(1, abs=0.2), row


def test_a_row_can_fail():
    errors = Errors(np.array([[0.1, 0.3], [-0.1, -0.3]]), np.full((2, 2), 0.1), 4)
    along, across = rows(5.0, 30.0, errors)
    assert along.holds and along.ratio == pytest.approx(1) and along.found_percent == 50
    assert not across.holds and across.ours_px == pytest.approx(0.3)
    nothing = Errors(np.empty((0, 2)), np.empty((0, 2)), 4)
    assert not any(row.holds for row in rows(5.0, 30.0, nothing))


def test_the_table_has_a_row_of_each_axis():
    result = run_smear_bench(trials=1, seed=2)
    assert len(result.rows) == 2 * len(STREAKS_PX) * len(SNRS)
