# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The protection level: what it bounds, and how often it is exceeded."""

import numpy as np
import pytest
from startracker_evaluation.campaign.protection import exceedance, Field, probability_of
from startracker_ros.core.integrity.protection import protection_level, ProtectionOptions

FIELD = Field.random(14, np.random.default_rng(3))


def level(options=ProtectionOptions(), **changes):
    return protection_level(**{**FIELD.arguments(np.zeros(14)), 'options': options, **changes})


@pytest.mark.parametrize(('event', 'known', 'tails'), [
    (lambda n: n[:, 4] > 5.3, 5.79e-8, [1]), (lambda n: np.abs(n[:, 4]) > 5.3, 1.158e-7, [1, -1])])
def test_rare_events_of_a_normal_value_have_their_known_probability(event, known, tails):
    # Q(5.3) and 2 Q(5.3), of one value among eleven.
    shifts = 5.3 * np.array(tails)[:, None] * np.eye(11)[4]
    found = probability_of(event, shifts, 4000, np.random.default_rng(1))
    assert abs(found.probability - known) < 4 * found.error and found.error < 0.06 * known


def test_a_region_that_the_shifts_do_not_show_is_not_counted_twice():
    # An event that is not rare: two shifts that lead nowhere near must not bias its probability.
    found = probability_of(lambda n: n[:, 0] > 0.0, 0.5 * np.eye(3)[:2], 20_000,
                           np.random.default_rng(2))
    assert found.probability == pytest.approx(0.5, abs=5 * found.error)


def test_the_level_is_exceeded_no_more_often_than_stated():
    options = ProtectionOptions()
    for false, draws in ((False, 1000), (True, 400)):
        found = exceedance(FIELD, options, false=false, draws=draws,
                           rng=np.random.default_rng(4))
        assert 0 < found.probability <= options.misleading_probability
    # The bound is not empty: without a false star it is that of a share of the probability.
    sigma = np.sqrt(np.diag(FIELD.covariance))
    assert (level(options) < 8 * sigma).all() and (level(options) > 3.5 * sigma).all()


def test_a_false_star_that_a_level_of_sigma_alone_would_hide():
    options = ProtectionOptions(false_star_probability=1e-3)
    tight = ProtectionOptions(false_star_probability=1e-9)
    assert (level(options) > level(tight)).all()
    residual = np.zeros(14)
    residual[3] = 4.0 * FIELD.sigma_rad[3]
    raised = protection_level(**FIELD.arguments(residual))
    assert (raised >= level()).all() and (raised > level()).any()
    assert (level(rejected=7) > level()).any()


def test_there_is_no_bound_where_every_star_is_needed():
    two = {name: value[:2] if name != 'covariance' else value
           for name, value in FIELD.arguments(np.zeros(14)).items()}
    assert np.isinf(protection_level(**two)).all()
    assert np.isinf(level(ProtectionOptions(false_star_probability=0.01))).all()
