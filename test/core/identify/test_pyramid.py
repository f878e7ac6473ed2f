# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When the search of triangles ends, and what that costs."""

from math import comb

from native_core import kernels
import numpy as np
import pytest
from skies import onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core import native
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.star_matcher import Rules, StarMatcher
from startracker_ros.core.maths.rotation import random_attitude

EPOCH_YEAR = 2026.5


@pytest.fixture(scope='module')
def identifier():
    return make_identifier(CAMERA, EPOCH_YEAR,
                           IdentificationOptions(magnitude_limit=6.0, time_limit_s=600.0))


@pytest.fixture(scope='module')
def matcher(identifier):
    """Return the matcher of an identifier in the library for tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, 'library', kernels)
        return StarMatcher(CAMERA, identifier.onboard, {}, Rules(identifier.scale_error))


def ends_after(matcher, count, tested=1000, most=1e-5, sigma_px=0.3, cost_ns=1e4):
    """Return the number of triangles of count stars after which the search ends."""
    return next(number for number in range(comb(count, 3) + 1) if kernels().stt_is_searched(
        matcher._tracker.handle, sigma_px * CAMERA.pixel_rad, count, number, cost_ns, tested,
        most))


def test_a_search_ends_when_an_acceptable_field_would_have_been_found(matcher):
    # Five of 15 stars have 10 of 455 triangles: half of all leaves (1 - 1/4)^10.
    ends = {count: ends_after(matcher, count) / comb(count, 3) for count in (8, 15, 30)}
    assert all(0.05 < share < 0.85 for share in ends.values())
    # More is needed where fewer stars can be accepted, as with less noise or fewer candidates.
    assert ends_after(matcher, 15, sigma_px=0.05) > ends_after(matcher, 15, sigma_px=1.0)
    assert ends_after(matcher, 15, tested=10) > ends_after(matcher, 15, tested=10 ** 6)


def test_a_search_ends_when_more_work_is_not_worth_it(matcher):
    """Ten times costlier triangles take hardly longer; of few stars all are looked up before."""
    ends = {(count, cost_ns): ends_after(matcher, count, cost_ns=cost_ns)
            for count in (15, 30, 60) for cost_ns in (1e4, 1e5)}
    assert all(1.5 < ends[count, 1e4] / ends[count, 1e5] < 10 for count in (30, 60))
    # A field is worth six seconds: a hundredth to a twentieth of it is spent on 60 stars.
    assert 0.05 < 1e4 * 1e-9 * ends[60, 1e4] < 1e5 * 1e-9 * ends[60, 1e5] < 0.3
    assert 1e4 * 1e-9 * ends[15, 1e4] < 0.005


def test_without_an_acceptable_field_it_ends_at_once(matcher):
    assert ends_after(matcher, 5, most=1e-30) == 0


def test_seven_stars_among_ten_false_ones_are_found_before_the_end(identifier):
    rng = np.random.default_rng(4)
    onboard, found = onboard_stars(CAMERA, EPOCH_YEAR, 6.0), 0
    for _ in range(60):
        q = random_attitude(rng)
        seen, hip = star_list(onboard, CAMERA, q, 0.3, rng, false=10)
        true = rng.permutation(np.flatnonzero(hip))[:7]
        seen = seen.select(np.sort(np.concatenate([true, np.flatnonzero(hip == 0)])))
        result = identifier.identify(seen)
        found += result.status == 'identified'
        assert result.status == 'no_candidate' or (
            np.count_nonzero(result.hip) >= 6 and set(result.hip) <= {0, *hip})
    # 98 of 100 are: fewer than 55 of 60 have a probability of 1e-3.
    assert found >= 55


def test_a_search_of_limited_work_is_the_same_on_every_machine(identifier):
    seen, _ = star_list(onboard_stars(CAMERA, EPOCH_YEAR, 6.0), CAMERA,
                        random_attitude(np.random.default_rng(5)), 0.3,
                        np.random.default_rng(5), missing=1.0, false=25)
    tested = []
    for work_s in (1e-3, 1e-3, 2e-3):
        result, spent_s = identifier.identify_within(seen, work_s)
        assert result.status == 'time_limit' and work_s < spent_s < work_s + 1e-3
        tested.append(int(result.reason.split(', ')[1].split()[0]))
    assert tested[0] == tested[1] < tested[2]
    _, spent_s = identifier.identify_within(seen, 100.0)
    assert 2e-3 < spent_s < 100.0
