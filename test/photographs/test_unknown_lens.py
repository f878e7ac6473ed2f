# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Wide lenses of which nothing is known are identified, without their centre, noise is not."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_evaluation.campaign.fisheyes import (
    draw_cropped, draw_mirrored, draw_night, EPOCH_YEAR, NO_SKIES, PROJECTIONS,
    run_fisheyes_campaign, SHAPES, SKIES, spots)
from startracker_evaluation.campaign.lenses import accepted_lens
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.blind import BlindIdentifier, LENS_ERROR
from startracker_ros.photographs.unknown_lens import (
    FISHEYES, neighbours, RECTILINEAR, UnknownLensIdentifier)

LONG = {'equisolid', 'orthographic', 'stereographic'}


@pytest.fixture(scope='module')
def identifier():
    return UnknownLensIdentifier(EPOCH_YEAR, BlindIdentifier(EPOCH_YEAR).wide_quads)


def error_px(identifier, night, lenses=FISHEYES):
    """Return the error of a night's stars in the lens that is found, None for none."""
    lens = accepted_lens(identifier.identify([night.centroids], night.shape, lenses), LENS_ERROR)
    return lens and night.error_px(SkyMapping(lens.camera, lens.attitude.quaternion))


@pytest.mark.slow
@pytest.mark.parametrize('projection', [
    pytest.param(projection, marks=[pytest.mark.long] * (projection in LONG))
    for projection in PROJECTIONS])
def test_a_fisheye_of_any_projection_is_found_and_fitted(identifier, projection):
    rng, solved = np.random.default_rng(len(projection)), 0
    for _ in range(4):
        night = draw_night(rng, projection)
        error = error_px(identifier, night)
        if error is not None:
            assert error < night.centroids.sigma_px[0]
            solved += 1
    # Of three hundred simulated ones at least 99 % are found.
    assert solved >= 3


def test_a_part_of_an_image_is_found_wherever_its_centre_is(identifier):
    rng, solved = np.random.default_rng(4), 0
    for _ in range(6):
        night = draw_cropped(rng)
        error = error_px(identifier, night, RECTILINEAR)
        if error is not None:
            assert error < 2 * night.centroids.sigma_px[0]
            solved += 1
    assert solved >= 5


def test_a_lens_that_has_grown_into_a_part_of_the_image_is_not_an_answer(identifier):
    rng = np.random.default_rng(1_000_003 + 75)
    night = [draw_cropped(rng) for _ in range(13)][-1]
    # As a fisheye 23 stars of the right sky fit it to 5 px, others are 180 px off.
    assert not list(identifier.identify([night.centroids], night.shape, FISHEYES))


def test_lamps_among_the_brightest_spots_do_not_hide_a_sky(identifier):
    # Of its 40 brightest spots 11 are not stars, among them the four brightest.
    night = draw_night(np.random.default_rng([2, 15, 9]), 'equisolid')
    assert error_px(identifier, night) < 1.0


@pytest.mark.parametrize('lenses', [FISHEYES, RECTILINEAR], ids=['fisheyes', 'rectilinear'])
@pytest.mark.parametrize('kind', NO_SKIES)
def test_spots_that_are_not_stars_have_no_lens(identifier, kind, lenses):
    rng = np.random.default_rng(2)
    for _ in range(2):
        night = NO_SKIES[kind](rng)
        assert not [*identifier.identify([night.centroids], night.shape, lenses)]


def test_few_spots_are_not_a_fisheye(identifier):
    rng, (height, width) = np.random.default_rng(2), SHAPES[1]
    for _ in range(4):
        few = spots(rng.uniform(0, [width - 1, height - 1], (12, 2)), rng.uniform(size=12), 0.3)
        assert not [*identifier.identify([few], SHAPES[1], FISHEYES)]


def test_a_mirrored_fisheye_is_found_as_mirrored(identifier):
    night = draw_mirrored(np.random.default_rng(4))
    back = replace(night.centroids, uv=[night.shape[1] - 1, 0] + night.centroids.uv * [-1, 1])
    assert next(identifier.identify_mirrored([back], night.shape, FISHEYES), None) is not None


@pytest.mark.long
def test_the_campaign_counts_nights_and_lists_without_a_sky():
    result = run_fisheyes_campaign(trials=1, seed=1)
    rows = {row.case: row for row in result.rows}
    assert rows['wrong'].holds and all(rows[f'accepted, {name}'].holds for name in NO_SKIES)
    assert rows['solved'].ours == np.mean(
        [rows[f'solved, {name}'].ours for name in SKIES])


def test_quads_of_neighbours_are_each_once():
    uv = np.random.default_rng(1).uniform(0, 1000, (30, 2))
    quads = neighbours(uv)
    assert len(np.unique(quads, axis=0)) == len(quads) > 300
    assert (np.diff(quads, axis=1) > 0).all()
    # So few are all neighbours of each other.
    assert len(neighbours(uv[:6])) == 15 and not len(neighbours(uv[:3]))
