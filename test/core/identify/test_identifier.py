# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lost-in-space identification of the real sky: right results, no wrong ones, clear reasons."""

from dataclasses import replace
import re

import numpy as np
import pytest
from skies import frame, onboard_stars, SMALL_CAMERA as CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import (
    attitude_error, quaternion_from_pointing, random_attitude)

EPOCH_YEAR = 2026.5


@pytest.fixture(scope='module')
def onboard():
    return onboard_stars(CAMERA, EPOCH_YEAR, 6.0)


@pytest.fixture(scope='module')
def identifier():
    return make_identifier(CAMERA, EPOCH_YEAR,
                           IdentificationOptions(magnitude_limit=6.0, time_limit_s=600.0))


def with_false(centroids, count, rng):
    """Add false stars, anywhere and as bright as any."""
    uv = np.concatenate([centroids.uv, rng.uniform(0, 511, (count, 2))])
    flux = np.concatenate([centroids.flux, rng.choice(centroids.flux, count)])
    order = rng.permutation(len(uv))
    return frame(uv[order], flux[order], centroids.sigma_px[0])


def off_by(result, q):
    """Return cross-boresight and rotation error in deg."""
    error = np.abs(np.degrees(attitude_error(result.attitude.quaternion, q)))
    return np.hypot(error[0], error[1]), error[2]


@pytest.mark.parametrize('sigma_px, false, least', [(0.3, 0, 0.97), (0.3, 5, 0.95)])
def test_random_attitudes(identifier, onboard, sigma_px, false, least):
    rng = np.random.default_rng(false)
    solved, count = 0, 60
    for _ in range(count):
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, CAMERA, q, sigma_px, rng)
        result = identifier.identify(with_false(centroids, false, rng))
        if result.status == 'identified':
            cross, roll = off_by(result, q)
            assert cross < 0.05 and roll < 0.5
            assert result.false_alarm_probability <= 1e-5
            solved += 1
        else:
            assert result.attitude is None and not result.hip.any() and result.reason
    assert solved >= least * count


def test_each_star_gets_its_own_number(identifier, onboard):
    rng = np.random.default_rng(4)
    for _ in range(20):
        centroids, hip = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)
        result = identifier.identify(centroids)
        known = result.hip > 0
        assert known.sum() == result.matched
        np.testing.assert_array_equal(result.hip[known], hip[known])
        assert np.isnan(result.magnitude[~known]).all() and np.isfinite(
            result.residual_px[known]).all()


@pytest.mark.slow
@pytest.mark.parametrize('count', [15, pytest.param(60, marks=pytest.mark.long)])
def test_false_stars_alone_are_never_accepted(identifier, count):
    rng = np.random.default_rng(5)
    quick = make_identifier(CAMERA, EPOCH_YEAR,
                            replace(identifier.options, time_limit_s=0.1))
    for _ in range(count):
        result = quick.identify(frame(rng.uniform(0, 511, (15, 2)), sigma_px=0.3))
        assert result.status in ('no_candidate', 'time_limit')
        assert result.attitude is None


def test_mirrored_fields_are_never_accepted(identifier, onboard):
    rng = np.random.default_rng(6)
    quick = make_identifier(CAMERA, EPOCH_YEAR,
                            replace(identifier.options, time_limit_s=0.1))
    for _ in range(30):
        centroids, _ = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)
        result = quick.identify(frame(centroids.uv * [-1, 1] + [511, 0], centroids.flux))
        assert result.attitude is None


def test_a_focal_length_within_its_tolerance_is_fitted(onboard):
    rng = np.random.default_rng(7)
    assumed = CAMERA.with_focal_ratio(1 / 1.004)
    identifier = make_identifier(assumed, EPOCH_YEAR, IdentificationOptions(magnitude_limit=6.0))
    ratios = []
    for _ in range(20):
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, CAMERA, q, 0.1, rng)
        result = identifier.identify(centroids)
        if result.attitude is not None:
            ratios.append(result.focal_ratio)
            assert off_by(result, q)[0] < 0.01
    # A field of N stars some 200 px off the centre gives 0.1 / 200 / sqrt(N), or 1.5e-4.
    assert len(ratios) >= 18
    assert np.mean(ratios) == pytest.approx(1.004, abs=1.5e-4)
    np.testing.assert_allclose(ratios, 1.004, atol=1e-3)


@pytest.mark.parametrize('ratio', [0.986, 1.014])
def test_a_wide_tolerance_of_the_focal_length_is_used(onboard, ratio):
    rng = np.random.default_rng(15)
    identifier = make_identifier(
        CAMERA.with_focal_ratio(1 / ratio), EPOCH_YEAR,
        IdentificationOptions(magnitude_limit=6.0, fov_error_percent=1.5))
    solved = 0
    for _ in range(20):
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, CAMERA, q, 0.1, rng)
        result = identifier.identify(centroids)
        if result.attitude is not None:
            assert off_by(result, q)[0] < 0.01
            assert result.focal_ratio == pytest.approx(ratio, abs=1e-3)
            solved += 1
    assert solved >= 19


def test_a_focal_length_far_off_gives_no_result(onboard):
    rng = np.random.default_rng(8)
    identifier = make_identifier(CAMERA.with_focal_ratio(1.05), EPOCH_YEAR,
                                 IdentificationOptions(magnitude_limit=6.0, time_limit_s=0.1))
    for _ in range(20):
        centroids, _ = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)
        assert identifier.identify(centroids).attitude is None


@pytest.mark.slow
@pytest.mark.parametrize('ratio, count', [(1 / 1.015, 10), *(
    pytest.param(ratio, 25, marks=pytest.mark.long) for ratio in (1 / 1.015, 1 / 1.03, 1.03))])
@pytest.mark.parametrize('ra_deg, dec_deg', [(56.75, 24.1), (66.7, 16.0)])
def test_a_wrong_lens_finds_nothing_in_a_cluster(onboard, ra_deg, dec_deg, ratio, count):
    """Around the Pleiades and the Hyades many stars still match, at a wrong attitude."""
    rng = np.random.default_rng(13)
    identifier = make_identifier(CAMERA.with_focal_ratio(ratio), EPOCH_YEAR,
                                 IdentificationOptions(magnitude_limit=6.0, time_limit_s=0.1))
    for _ in range(count):
        pointing = [ra_deg + rng.uniform(-4, 4), dec_deg + rng.uniform(-4, 4),
                    rng.uniform(0, 360)]
        q = quaternion_from_pointing(*np.radians(pointing))
        centroids, _ = star_list(onboard, CAMERA, q, 0.3, rng)
        result = identifier.identify(centroids)
        assert result.attitude is None or off_by(result, q)[0] < 0.05


def test_a_field_of_view_known_to_five_percent(onboard):
    rng = np.random.default_rng(16)
    identifier = make_identifier(
        CAMERA, EPOCH_YEAR, IdentificationOptions(magnitude_limit=6.0, fov_error_percent=5.0))
    for _ in range(20):
        true = CAMERA.with_focal_ratio(rng.uniform(0.95, 1.05))
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, true, q, 0.3, rng)
        result = identifier.identify(centroids)
        assert result.status == 'identified'
        assert result.focal_ratio == pytest.approx(true.fx / CAMERA.fx, abs=2e-3)
        assert off_by(result, q)[0] < 0.05


@pytest.mark.long
def test_the_false_alarm_probability_is_honest(onboard):
    """Of fields without a single true star, one in ten may claim 0.1 or less, one in 100 0.01."""
    rng = np.random.default_rng(17)
    identifier = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
        magnitude_limit=6.0, false_alarm_max=1e-29, time_limit_s=0.3))
    claimed = []
    for _ in range(40):
        count = rng.integers(8, 25)
        result = identifier.identify(frame(rng.uniform(0, 511, (count, 2)), sigma_px=1.0))
        claimed.append(result.false_alarm_probability)
    claimed = np.array(claimed)
    # The bounds of a binomial distribution that 1 run in 1000 exceeds.
    assert (claimed <= 0.1).sum() <= 11
    assert (claimed <= 0.01).sum() <= 3
    # Nor is it a number that is always one.
    assert (claimed < 0.9).any()


def test_false_stars_may_be_brighter_than_all_true_ones(onboard):
    rng = np.random.default_rng(18)
    identifier = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(magnitude_limit=6.0))
    solved = 0
    for _ in range(30):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng, false=20, missing=0.1,
                                   brightest_false=-1.0)
        result = identifier.identify(centroids)
        if result.attitude is not None:
            assert off_by(result, q)[0] < 0.05
            assert (result.hip[hip == 0] == 0).mean() > 0.9
            solved += 1
    assert solved >= 28


def test_a_result_with_the_order_of_brightness_reversed_costs_more(identifier, onboard):
    """The order of brightness is evidence, but not required."""
    rng = np.random.default_rng(19)
    ratios = []
    for _ in range(20):
        q = random_attitude(rng)
        centroids, _ = star_list(onboard, CAMERA, q, 0.1, rng)
        right = identifier.identify(centroids)
        reversed_ = identifier.identify(replace(centroids, flux=centroids.flux[::-1]))
        if right.status == reversed_.status == 'identified':
            assert off_by(reversed_, q)[0] < 0.05
            ratios.append(right.false_alarm_probability / reversed_.false_alarm_probability)
    assert len(ratios) >= 15 and np.median(ratios) < 1e-3


def test_a_catalogue_without_pairs_gives_no_result(onboard):
    rng = np.random.default_rng(14)
    centroids, _ = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)
    identifier = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(magnitude_limit=0.01))
    result = identifier.identify(centroids)
    assert result.status == 'no_candidate'
    assert 'a field holds 0.0 catalogue stars' in result.reason


@pytest.mark.slow
def test_a_catalogue_too_deep_for_the_field_is_not_a_burden():
    """Two thousand stars in a field: bounded pairs, and still the right result."""
    camera = Camera.from_fov(512, 512, 40.0)
    sky = onboard_stars(camera, EPOCH_YEAR, 4.0)
    identifier = make_identifier(camera, EPOCH_YEAR, IdentificationOptions(magnitude_limit=8.0))
    rng = np.random.default_rng(20)
    solved = 0
    for _ in range(10):
        q = random_attitude(rng)
        centroids, _ = star_list(sky, camera, q, 0.1, rng)
        result = identifier.identify(centroids)
        if result.attitude is not None:
            assert off_by(result, q)[0] < 0.05
            solved += 1
    assert solved >= 8


@pytest.mark.parametrize('count', [0, 1, 3])
def test_too_few_stars(identifier, onboard, count):
    rng = np.random.default_rng(9)
    centroids, _ = star_list(onboard, CAMERA, random_attitude(rng), 0.1, rng)
    result = identifier.identify(frame(centroids.uv[:count], centroids.flux[:count]))
    assert result.status == 'too_few_stars'
    assert f'{count} usable stars' in result.reason
    assert len(result.hip) == count


def test_useless_rows_are_left_out(identifier, onboard):
    """NaN, outside the image, found twice: the rest still gives the right result."""
    rng = np.random.default_rng(10)
    q = random_attitude(rng)
    centroids, _ = star_list(onboard, CAMERA, q, 0.1, rng)
    bad = [[np.nan, 5.0], [-50.0, 10.0], [1e6, 1e6], *(centroids.uv[:3] + 0.2)]
    uv = np.concatenate([bad, centroids.uv])
    flux = np.concatenate([np.full(6, 1e9), centroids.flux])
    result = identifier.identify(frame(uv, flux))
    assert result.status == 'identified'
    assert not result.hip[:3].any()
    assert off_by(result, q)[0] < 0.02


def test_thousands_of_centroids_are_bounded_work():
    """The brightest are used; the time limit ends the search long before its own end."""
    rng = np.random.default_rng(11)
    centroids = frame(rng.uniform(0, 511, (5000, 2)), sigma_px=0.3)

    def searched(time_limit_s, max_image_stars=40):
        result = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
            magnitude_limit=6.0, time_limit_s=time_limit_s,
            max_image_stars=max_image_stars)).identify(centroids)
        return result, int(re.search(r'(\d+) candidates tested', result.reason)[1])
    whole, tested = searched(600.0)
    assert whole.status == 'no_candidate' and whole.reason.startswith('40 stars, ')
    assert 1_000 < tested < 100_000
    part, fewer = searched(0.001)
    assert part.status == 'time_limit' and fewer < tested / 2
    assert part.reason == f'not identified within time_limit_s = 0.001, {fewer} candidates tested'
    assert searched(0.02, 100)[0].status == 'time_limit'


def test_two_skies_in_one_image_are_ambiguous_or_one_of_them(identifier, onboard):
    rng = np.random.default_rng(12)
    for _ in range(10):
        both = [random_attitude(rng), random_attitude(rng)]
        uv = np.concatenate([star_list(onboard, CAMERA, q, 0.1, rng)[0].uv for q in both])
        result = identifier.identify(frame(rng.permutation(uv)))
        if result.attitude is not None:
            assert min(off_by(result, q)[0] for q in both) < 0.05


def test_the_magnitude_limit_follows_the_field():
    wide = make_identifier(Camera.from_fov(512, 512, 20.0), EPOCH_YEAR)
    narrow = make_identifier(Camera.from_fov(512, 512, 8.0), EPOCH_YEAR)
    assert 4.5 < wide.magnitude_limit < 5.5 < narrow.magnitude_limit < 7.5
