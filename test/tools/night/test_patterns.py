# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Patterns in the residuals of stars: found, and separated from attitude and noise."""

from night_sky import CAMERA
import numpy as np
import pytest
from scipy import stats
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.tools.night.intervals import CONFIDENCE
from startracker_ros.tools.night.patterns import (
    field_columns, field_degree, fit_pattern, PHASE_COLUMNS, phase_columns, single_coefficient,
    Stars, turns_of, without_turns)

FRAMES, STARS = 30, 60
NOISE_PX, STAR_PX, TURN_RAD = 0.05, 0.05, 1e-4
DEGREE = 2


def night(rng, shift=lambda uv: 0.0):
    """Return stars that wander over the field, each off by a constant, in frames that turn."""
    begin = rng.uniform(0, CAMERA.width - 1, (STARS, 2))
    step = rng.uniform(-1.5, 1.5, 2)
    uv = (begin + step * np.arange(FRAMES)[:, None, None]) % (CAMERA.width - 1)
    frame, star = np.indices((FRAMES, STARS)).reshape(2, -1)
    uv = uv.reshape(-1, 2)
    jacobian = image_jacobian(CAMERA, CAMERA.unproject(uv))
    turn = rng.normal(0, TURN_RAD, (FRAMES, 3))
    residual = (np.einsum('nki,ni->nk', jacobian, turn[frame]) + shift(uv)
                + rng.normal(0, STAR_PX, (STARS, 2))[star] + rng.normal(0, NOISE_PX, uv.shape))
    count = len(uv)
    return Stars(frame, star, np.full(count, 5.0), uv, np.ones(count, bool), residual,
                 np.full(count, NOISE_PX), jacobian, np.zeros((count, 2)))


def fitted(stars):
    return fit_pattern(stars, np.concatenate(
        [phase_columns(stars.uv), field_columns(stars.uv, CAMERA, DEGREE)], axis=-1))


@pytest.mark.slow
def test_without_a_pattern_none_is_found_but_by_chance():
    rng = np.random.default_rng(1)
    trials = 60
    parts = [fitted(night(rng)).part(chosen) for _ in range(trials)
             for chosen in (slice(0, PHASE_COLUMNS), slice(PHASE_COLUMNS, None))]
    found = sum(each.found for each in parts)
    assert found <= stats.binom.ppf(0.999, len(parts), 1 - CONFIDENCE)


@pytest.mark.parametrize('size_px', (0.2, 0.03))
@pytest.mark.parametrize('chosen, columns', (
    (slice(PHASE_COLUMNS, None), lambda uv: field_columns(uv, CAMERA, DEGREE)),
    (slice(0, PHASE_COLUMNS), phase_columns)))
def test_the_size_of_a_pattern_is_within_its_interval(chosen, columns, size_px):
    rng = np.random.default_rng(2)
    trials, covered, excess = 40, 0, []
    for _ in range(trials):
        coefficients = rng.normal(0, size_px, columns(np.zeros((1, 2))).shape[-1])
        stars = night(rng, lambda uv: columns(uv) @ coefficients)  # noqa: B023
        part = fitted(stars).part(chosen)
        left = without_turns(stars, part.columns)
        truth = np.sqrt(np.mean((left @ coefficients) ** 2))
        row = part.rms(left)
        assert size_px < 0.1 or part.found and row.low > 0
        covered += row.low <= truth <= row.high
        excess.append(row.value ** 2 - truth ** 2)
    assert covered >= stats.binom.ppf(0.001, trials, 0.95)
    # The errors of the coefficients do not add to the size.
    assert np.mean(excess) < 3 * np.std(excess, ddof=1) / trials ** 0.5


def test_a_turn_is_not_a_pattern():
    stars = night(np.random.default_rng(3))
    turn = np.random.default_rng(4).normal(0, 1e-4, (FRAMES, 3))
    shift = np.einsum('nki,ni->nk', stars.jacobian, turn[stars.frame])[..., None]
    np.testing.assert_allclose(turns_of(stars, shift)[..., 0], turn, atol=1e-12)
    assert np.abs(without_turns(stars, shift)).max() < 1e-9


def test_a_single_coefficient_is_separated_from_scale_and_bending():
    rng = np.random.default_rng(5)
    trials, covered = 40, 0
    for _ in range(trials):
        bend = rng.normal(0, 0.3, field_columns(np.zeros((1, 2)), CAMERA, DEGREE,
                                                shear=False).shape[-1])

        def shear(uv):
            return np.stack([uv[:, 1] - 160.0, np.zeros(len(uv))], axis=-1) / 100

        def shift(uv):
            return 0.4 * shear(uv) + field_columns(
                uv, CAMERA, DEGREE, shear=False) @ bend  # noqa: B023
        stars = night(rng, shift)
        row = single_coefficient(stars, CAMERA, shear(stars.uv), DEGREE)
        covered += row.low <= 0.4 <= row.high
    assert covered >= stats.binom.ppf(0.001, trials, 0.95)


def test_few_stars_give_fewer_coefficients_and_then_none():
    stars = night(np.random.default_rng(6))
    assert field_degree(stars, CAMERA) == 3
    assert field_degree(stars.select(stars.star < 30), CAMERA) == 2
    few = stars.select(stars.star < 8)
    assert field_degree(few, CAMERA) == 0 and fitted(few) is None
    assert np.isnan(single_coefficient(few, CAMERA, few.residual, 0).value)
